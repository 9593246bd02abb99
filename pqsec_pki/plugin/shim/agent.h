/* Where the agent listens, and starting it. */

#ifndef PQSEC_AGENT_H
#define PQSEC_AGENT_H

#include "link.h"

enum { AGENT_START_MS = 15000 };

/* How long a call may take: PQSEC_AGENT_TIMEOUT in ms, else 5000. */
int agent_patience_ms(void);

/* The path of the agent's socket; makes its folder. False, and why, if it cannot be trusted. */
bool agent_place(char *path, size_t size, struct exception *);

/* Starts an agent that will listen there. Gives the process that has to end well, which it does
 * once the agent listens; 0, and why, if there is none. */
pid_t agent_start(const char *path, struct exception *);

#endif
