/* Preloaded: a network that loses one datagram in ten that its host sends by UDP. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>

enum { ONE_IN = 10 };

static int is_lost(const struct sockaddr *to)
{
  static _Thread_local unsigned state;
  if (to == NULL || to->sa_family != AF_INET)
    return 0;
  if (state == 0) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    state = (unsigned)now.tv_nsec | 1;
  }
  return rand_r(&state) % ONE_IN == 0;
}

ssize_t sendmsg(int socket, const struct msghdr *message, int flags)
{
  size_t size = 0;
  for (size_t i = 0; i < message->msg_iovlen; i++)
    size += message->msg_iov[i].iov_len;
  if (is_lost(message->msg_name))
    return (ssize_t)size;
  ssize_t (*original)(int, const struct msghdr *, int) = dlsym(RTLD_NEXT, "sendmsg");
  return original(socket, message, flags);
}

ssize_t sendto(int socket, const void *data, size_t size, int flags, const struct sockaddr *to,
               socklen_t length)
{
  if (is_lost(to))
    return (ssize_t)size;
  ssize_t (*original)(int, const void *, size_t, int, const struct sockaddr *, socklen_t) =
      dlsym(RTLD_NEXT, "sendto");
  return original(socket, data, size, flags, to, length);
}
