/* One thread for each plugin that has deadlines: it sleeps until the next of them. */

#define _GNU_SOURCE
#include "watch.h"

#include <signal.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

struct deadline { struct deadline *next; handle_t handle; int64_t when; };

enum { STACK = 512 << 10 }; /* octets: Cyclone deletes a participant on it */
enum { SECOND = 1000000000 }; /* nanoseconds */

/* The clock of certificates, which may be set. */
static struct timespec wall_clock(void)
{
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  return now;
}

/* Waiting for a change uses the clock that cannot be set. */
static void make_locks(struct watch *watch)
{
  pthread_condattr_t attributes;
  pthread_mutex_init(&watch->mutex, NULL);
  pthread_condattr_init(&attributes);
  pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
  pthread_cond_init(&watch->changed, &attributes);
  pthread_condattr_destroy(&attributes);
}

void watch_init(struct watch *watch, const void *plugin)
{
  *watch = (struct watch){.plugin = plugin, .process = getpid()};
  make_locks(watch);
}

/* A fork has no thread, and its mutex and condition are in an undefined state. */
static void own(struct watch *watch)
{
  if (watch->process == getpid())
    return;
  watch->process = getpid();
  watch->running = watch->calling = false;
  make_locks(watch);
}

/* With the mutex, which is released while a listener runs. */
static void leave(struct watch *watch)
{
  watch->calling = true;
  pthread_mutex_unlock(&watch->mutex);
}

static void come_back(struct watch *watch)
{
  pthread_mutex_lock(&watch->mutex);
  watch->calling = false;
  pthread_cond_broadcast(&watch->changed);
}

static void tell(struct watch *watch)
{
  struct deadline *due = watch->first;
  handle_t handle = due->handle;
  revoked listener = watch->listener;
  watch->first = due->next;
  free(due);
  if (listener == NULL)
    return;
  leave(watch);
  listener(watch->plugin, handle);
  come_back(watch);
}

static void look(struct watch *watch, int64_t now)
{
  watch->next = now + LOOK_SECONDS;
  leave(watch);
  watch->look(watch->plugin);
  come_back(watch);
}

/* Waits for a change, the next deadline or the next look; never long: the clock may be set. */
static void sleep_on(struct watch *watch)
{
  if (watch->first == NULL && watch->look == NULL) {
    pthread_cond_wait(&watch->changed, &watch->mutex);
    return;
  }
  struct timespec now = wall_clock(), until;
  int64_t next = now.tv_sec + LOOK_SECONDS;
  if (watch->first != NULL && watch->first->when < next)
    next = watch->first->when;
  if (watch->look != NULL && watch->next < next)
    next = watch->next;
  int64_t left = next > now.tv_sec ? (next - now.tv_sec) * SECOND - now.tv_nsec : 0;
  clock_gettime(CLOCK_MONOTONIC, &until);
  left += until.tv_nsec;
  until.tv_sec += (time_t)(left / SECOND);
  until.tv_nsec = (long)(left % SECOND);
  pthread_cond_timedwait(&watch->changed, &watch->mutex, &until);
}

static void *run(void *argument)
{
  struct watch *watch = argument;
  pthread_mutex_lock(&watch->mutex);
  while (!watch->ending) {
    int64_t now = wall_clock().tv_sec;
    if (watch->next > now + LOOK_SECONDS) /* the clock was set back */
      watch->next = now;
    if (watch->first != NULL && watch->first->when <= now)
      tell(watch);
    else if (watch->look != NULL && watch->next <= now)
      look(watch, now);
    else
      sleep_on(watch);
  }
  pthread_mutex_unlock(&watch->mutex);
  return NULL;
}

/* With the mutex. The host's signals are for the host's threads. */
static void start(struct watch *watch)
{
  if (watch->running)
    return;
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
  own(watch);
  pthread_mutex_lock(&watch->mutex);
  forget_deadline(watch, handle);
  struct deadline **at = &watch->first;
  while (*at != NULL && (*at)->when <= when)
    at = &(*at)->next;
  *fresh = (struct deadline){.next = *at, .handle = handle, .when = when};
  *at = fresh;
  start(watch);
  pthread_cond_broadcast(&watch->changed);
  pthread_mutex_unlock(&watch->mutex);
}

void watch_look(struct watch *watch, void (*look)(const void *plugin))
{
  own(watch);
  pthread_mutex_lock(&watch->mutex);
  if (watch->look == NULL)
    watch->next = wall_clock().tv_sec + LOOK_SECONDS;
  watch->look = look;
  start(watch);
  pthread_cond_broadcast(&watch->changed);
  pthread_mutex_unlock(&watch->mutex);
}

void watch_remove(struct watch *watch, handle_t handle)
{
  own(watch);
  pthread_mutex_lock(&watch->mutex);
  forget_deadline(watch, handle);
  pthread_mutex_unlock(&watch->mutex);
}

void watch_tell(struct watch *watch, revoked listener)
{
  own(watch);
  pthread_mutex_lock(&watch->mutex);
  watch->listener = listener;
  bool within = watch->running && pthread_equal(pthread_self(), watch->thread);
  while (watch->calling && !within) /* a listener may remove itself */
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
