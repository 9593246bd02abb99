/* One thread for each plugin that has deadlines: it sleeps until the next of them. */

#define _GNU_SOURCE
#include "watch.h"

#include <signal.h>
#include <stdlib.h>
#include <time.h>

struct deadline { struct deadline *next; handle_t handle; int64_t when; };

enum { STACK = 512 << 10 }; /* octets: Cyclone deletes a participant on it */

void watch_init(struct watch *watch, const void *plugin)
{
  *watch = (struct watch){.plugin = plugin};
  pthread_mutex_init(&watch->mutex, NULL);
  pthread_cond_init(&watch->changed, NULL);
}

/* With the mutex, which is not held while the listener runs. */
static void tell(struct watch *watch)
{
  struct deadline *due = watch->first;
  handle_t handle = due->handle;
  revoked listener = watch->listener;
  watch->first = due->next;
  free(due);
  if (listener == NULL)
    return;
  watch->calling = true;
  pthread_mutex_unlock(&watch->mutex);
  listener(watch->plugin, handle);
  pthread_mutex_lock(&watch->mutex);
  watch->calling = false;
  pthread_cond_broadcast(&watch->changed);
}

static void *run(void *argument)
{
  struct watch *watch = argument;
  pthread_mutex_lock(&watch->mutex);
  while (!watch->ending) {
    if (watch->first == NULL) {
      pthread_cond_wait(&watch->changed, &watch->mutex);
    } else if (watch->first->when <= (int64_t)time(NULL)) {
      tell(watch);
    } else {
      struct timespec until = {.tv_sec = (time_t)watch->first->when};
      pthread_cond_timedwait(&watch->changed, &watch->mutex, &until);
    }
  }
  pthread_mutex_unlock(&watch->mutex);
  return NULL;
}

/* The host's signals are for the host's threads. */
static void start(struct watch *watch)
{
  sigset_t all, before;
  pthread_attr_t attributes;
  sigfillset(&all);
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, STACK);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  watch->running = pthread_create(&watch->thread, &attributes, run, watch) == 0;
  pthread_sigmask(SIG_SETMASK, &before, NULL);
  pthread_attr_destroy(&attributes);
}

static void forget_deadline(struct watch *watch, handle_t handle)
{
  for (struct deadline **at = &watch->first; *at != NULL; at = &(*at)->next)
    if ((*at)->handle == handle) {
      struct deadline *found = *at;
      *at = found->next;
      free(found);
      return;
    }
}

void watch_add(struct watch *watch, handle_t handle, int64_t when)
{
  struct deadline *fresh = when != 0 ? malloc(sizeof *fresh) : NULL;
  if (fresh == NULL)
    return;
  pthread_mutex_lock(&watch->mutex);
  forget_deadline(watch, handle);
  struct deadline **at = &watch->first;
  while (*at != NULL && (*at)->when <= when)
    at = &(*at)->next;
  *fresh = (struct deadline){.next = *at, .handle = handle, .when = when};
  *at = fresh;
  if (!watch->running)
    start(watch);
  pthread_cond_broadcast(&watch->changed);
  pthread_mutex_unlock(&watch->mutex);
}

void watch_remove(struct watch *watch, handle_t handle)
{
  pthread_mutex_lock(&watch->mutex);
  forget_deadline(watch, handle);
  pthread_mutex_unlock(&watch->mutex);
}

void watch_tell(struct watch *watch, revoked listener)
{
  pthread_mutex_lock(&watch->mutex);
  watch->listener = listener;
  bool within = watch->running && pthread_equal(pthread_self(), watch->thread);
  while (watch->calling && !within) /* a listener may take itself away */
    pthread_cond_wait(&watch->changed, &watch->mutex);
  pthread_mutex_unlock(&watch->mutex);
}

void watch_end(struct watch *watch)
{
  watch_tell(watch, NULL);
  pthread_mutex_lock(&watch->mutex);
  watch->ending = true;
  pthread_cond_broadcast(&watch->changed);
  pthread_mutex_unlock(&watch->mutex);
  if (watch->running)
    pthread_join(watch->thread, NULL);
  while (watch->first != NULL)
    forget_deadline(watch, watch->first->handle);
  pthread_cond_destroy(&watch->changed);
  pthread_mutex_destroy(&watch->mutex);
}
