/* Tells Cyclone DDS when identities and permissions expire or are revoked. */

#ifndef PQSEC_WATCH_H
#define PQSEC_WATCH_H

#include <pthread.h>
#include <sys/types.h>

#include "wire.h"

enum { LOOK_SECONDS = 5, LONG_AGO = 1 };

struct deadline;

struct watch {
  const void *plugin; /* the listener's argument */
  pthread_mutex_t mutex;
  pthread_cond_t changed;
  pthread_t thread;
  pid_t process; /* whose thread it is: a fork has none */
  bool running, ending, calling;
  revoked listener;
  struct deadline *first;
  void (*look)(const void *plugin);
  int64_t next; /* the second when to look */
};

void watch_init(struct watch *, const void *plugin);

/* `handle` expires at that second of Unix time; 0 is never. */
void watch_add(struct watch *, handle_t handle, int64_t when);

/* From now on `look` is called every LOOK_SECONDS, to add what was revoked. */
void watch_look(struct watch *, void (*look)(const void *plugin));
void watch_remove(struct watch *, handle_t handle);

/* Sets the listener; NULL for none. Returns when no call to the former one is running. */
void watch_tell(struct watch *, revoked listener);

void watch_end(struct watch *);

#endif
