/* When identities and permissions end: Cyclone wants to be told. */

#ifndef PQSEC_WATCH_H
#define PQSEC_WATCH_H

#include <pthread.h>

#include "wire.h"

struct deadline;

struct watch {
  const void *plugin; /* what the listener is given */
  pthread_mutex_t mutex;
  pthread_cond_t changed;
  pthread_t thread;
  bool running, ending, calling;
  revoked listener;
  struct deadline *first;
};

void watch_init(struct watch *, const void *plugin);

/* `handle` ends at that second since 1970; 0 is never. */
void watch_add(struct watch *, handle_t handle, int64_t when);
void watch_remove(struct watch *, handle_t handle);

/* Whom to tell; NULL for nobody. Returns when no call to the former one is under way. */
void watch_tell(struct watch *, revoked listener);

void watch_end(struct watch *);

#endif
