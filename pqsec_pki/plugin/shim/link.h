/* The connection to the agent: one for each plugin that Cyclone loads. */

#ifndef PQSEC_LINK_H
#define PQSEC_LINK_H

#include <pthread.h>
#include <sys/types.h>

#include "wire.h"

struct link {
  const char *plugin; /* "authentication" or "access_control" */
  pthread_mutex_t mutex;
  int socket; /* -1: not connected */
  pid_t process; /* its owner: a fork must not use its parent's connection */
  bool lost;     /* whether the agent closed the last connection */
};

void link_init(struct link *, const char *plugin);

/* Connects, and starts the agent if it does not run. False, with the reason, if that fails. */
bool link_open(struct link *, struct exception *);

/* Calls a function of the agent. `kinds` has a letter for each argument: those of the call,
 * `>`, and pointers for the results. Returns the agent's result, or -1 with the reason.
 *
 *     h handle   n int32   s string   o struct octets *   t struct token *   g struct guid *
 *     p struct strings *   d struct tags *   q struct qos *, of which the properties
 *     results also:   b uint8_t *   m uint32_t *   x int64_t *   c uint8_t[32]
 *
 * After an error of the connection it is closed, and every call fails until it is opened again:
 * the handles were the lost agent's. */
int ask(struct link *, struct exception *, const char *function, const char *kinds, ...);

void link_close(struct link *);

void refuse(struct exception *, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
