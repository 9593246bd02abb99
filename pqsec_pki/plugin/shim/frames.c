/* Sends and receives complete frames, before a deadline. */

#define _GNU_SOURCE
#include "frames.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>

enum { HEAD = 4 };

int64_t now_ms(void)
{
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Waits until the socket can be read or written; false if that is not before `deadline`. */
static bool ready(int socket, short event, int64_t deadline)
{
  for (;;) {
    int64_t left = deadline - now_ms();
    struct pollfd one = {.fd = socket, .events = event};
    int found = poll(&one, 1, left > 0 ? (int)left : 0);
    if (found > 0)
      return true;
    if (found == 0 || errno != EINTR) {
      errno = found == 0 ? ETIMEDOUT : errno;
      return false;
    }
  }
}

static bool again(ssize_t count) { return count < 0 && (errno == EAGAIN || errno == EINTR); }

static bool send_all(int socket, const uint8_t *data, size_t size, int64_t deadline)
{
  while (size > 0) {
    ssize_t count = send(socket, data, size, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (again(count) ? !ready(socket, POLLOUT, deadline) : count < 0)
      return false;
    if (count > 0) {
      data += count;
      size -= (size_t)count;
    }
  }
  return true;
}

static bool receive_all(int socket, uint8_t *data, size_t size, int64_t deadline)
{
  while (size > 0) {
    ssize_t count = recv(socket, data, size, MSG_DONTWAIT);
    if (count == 0)
      errno = ECONNRESET; /* the agent is gone */
    if (again(count) ? !ready(socket, POLLIN, deadline) : count <= 0)
      return false;
    if (count > 0) {
      data += count;
      size -= (size_t)count;
    }
  }
  return true;
}

struct writer new_frame(void)
{
  struct writer frame = {0};
  put_u32(&frame, 0);
  return frame;
}

bool send_frame(int socket, const struct writer *frame, int64_t deadline)
{
  size_t size = frame->size - HEAD;
  for (int i = 0; i < HEAD; i++)
    frame->data[i] = (uint8_t)(size >> 8 * i);
  return send_all(socket, frame->data, frame->size, deadline);
}

bool receive_frame(int socket, struct writer *body, int patience)
{
  int64_t now = now_ms(), end = now + (int64_t)MAX_PATIENCE * patience, deadline = now + patience;
  uint32_t size = 0;
  while (size == 0) {
    uint8_t head[HEAD];
    if (!receive_all(socket, head, sizeof head, deadline)) {
      errno = errno == ETIMEDOUT && deadline == end ? EBUSY : errno;
      return false;
    }
    struct reader reader = {.data = head, .left = sizeof head};
    size = get_u32(&reader);
    deadline = now_ms() + patience < end ? now_ms() + patience : end;
  }
  body->data = size <= MAX_FRAME ? malloc((size_t)size + 1) : NULL;
  if (body->data == NULL) {
    errno = EPROTO;
    return false;
  }
  body->size = body->capacity = size;
  return receive_all(socket, body->data, size, deadline);
}
