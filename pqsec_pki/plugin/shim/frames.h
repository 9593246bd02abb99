/* Frames on a socket: a 32-bit length, little-endian, and that many octets.
 *
 * Deadlines are milliseconds of now_ms(). What fails leaves the reason in errno. */

#ifndef PQSEC_FRAMES_H
#define PQSEC_FRAMES_H

#include "wire.h"

int64_t now_ms(void);

/* A frame is written after space for its length, so that both are sent at once. */
struct writer new_frame(void);
bool send_frame(int socket, const struct writer *frame, int64_t deadline);

/* The content of the next frame, which must arrive within `patience` ms; the caller must forget
 * `body` in any case. An empty frame means that the agent works; the time then begins again, up to
 * MAX_PATIENCE times; after them errno is EBUSY. */
enum { MAX_PATIENCE = 12 };
bool receive_frame(int socket, struct writer *body, int patience);

#endif
