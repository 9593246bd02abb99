/* Finds the agent's socket, and starts the agent. */

#ifndef PQSEC_AGENT_H
#define PQSEC_AGENT_H

#include "link.h"

#define TOKENS_MODULE "PQSEC_PKCS11_MODULE"
#define TOKENS_PIN_FILE "PQSEC_PIN_FILE"

enum { AGENT_START_MS = 15000 };

/* How long a call may take: PQSEC_AGENT_TIMEOUT in ms, else 5000. */
int agent_patience_ms(void);

/* The path of the agent's socket; creates its folder. False, with the reason in the exception, if
 * the folder cannot be trusted. */
bool agent_place(char *path, size_t size, struct exception *);

/* Which files paths name in this process: its mount name space, if known, and root folder.
 * greeting.py has the same in Python. */
const char *files_seen(char *text, size_t size);

/* Whether this process may start the agent that will listen there: one process at a time does, since
 * a robot starts a hundred hosts at once. `*lock` is to be closed when the agent listens, if it is
 * not -1. */
bool agent_may_start(const char *path, int *lock);

/* Starts an agent that will listen there. Returns the process that exits with 0 when the agent
 * listens; 0, with the reason in the exception, if it cannot be started. */
pid_t agent_start(const char *path, struct exception *);

#endif
