/* Connects to the agent, and calls it over its socket. */

#define _GNU_SOURCE
#include "link.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "agent.h"
#include "frames.h"

enum { VERSION = 4, RETRY_MS = 1, OTHERS_RETRY_MS = 10, CHALLENGE = 32 };
enum { DONE = 0, MOST_TRIES = 10 };

void refuse(struct exception *ex, const char *format, ...)
{
  if (ex == NULL)
    return;
  va_list arguments;
  va_start(arguments, format);
  char *text = NULL;
  int size = vasprintf(&text, format, arguments);
  va_end(arguments);
  *ex = (struct exception){.message = size < 0 ? NULL : text, .code = ERROR_CODE, .minor_code = 1};
}

static void forgive(struct exception *ex)
{
  if (ex != NULL) {
    free(ex->message);
    *ex = (struct exception){0};
  }
}

void link_init(struct link *link, const char *plugin)
{
  *link = (struct link){.plugin = plugin, .socket = -1, .process = getpid()};
  pthread_mutex_init(&link->mutex, NULL);
}

static void drop(struct link *link)
{
  if (link->socket >= 0)
    close(link->socket);
  link->socket = -1;
}

/* After a fork, the connection and the held mutex belong to the parent. */
static void hold(struct link *link)
{
  if (link->process != getpid()) {
    link->process = getpid();
    pthread_mutex_init(&link->mutex, NULL);
    drop(link);
  }
  pthread_mutex_lock(&link->mutex);
}

void link_close(struct link *link)
{
  hold(link);
  drop(link);
  pthread_mutex_unlock(&link->mutex);
}

/* Sends a request. A full agent closes the connection at once, after a refusal. */
static bool has_sent(struct link *link, const struct writer *request, int64_t deadline)
{
  return send_frame(link->socket, request, deadline) || errno == EPIPE || errno == ECONNRESET;
}

/* Sends a request and reads its answer. Any failure closes the connection: a late
 * answer would be read as the answer to the next request. */
static bool exchange(struct link *link, const struct writer *request, struct writer *answer,
                     struct exception *ex)
{
  int patience = agent_patience_ms();
  if (has_sent(link, request, now_ms() + patience) &&
      receive_frame(link->socket, answer, patience))
    return true;
  link->lost = errno == ECONNRESET || errno == EPIPE;
  if (errno == ETIMEDOUT)
    refuse(ex, "pqsec: the agent does not answer within %d ms; `pqsec agent log` may show why",
           patience);
  else if (errno == EBUSY)
    refuse(ex, "pqsec: the agent is too busy: no answer within %d ms", MAX_PATIENCE * patience);
  else
    refuse(ex, "pqsec: the agent is gone (%s); `pqsec agent log` may show why", strerror(errno));
  drop(link);
  return false;
}

/* Reads the begin of an answer: 0, or 1 and the reason of a refusal. */
static bool accepted(struct reader *reader, struct exception *ex)
{
  if (get_u8(reader) == DONE && !reader->failed)
    return true;
  char *why = get_string(reader);
  refuse(ex, "pqsec: %s", why != NULL ? why : "the agent's answer is malformed");
  free(why);
  return false;
}

static bool greet(struct link *link, struct exception *ex)
{
  struct writer hello = new_frame(), answer = {0};
  char seen[128];
  put_string(&hello, "pqsec");
  put_u32(&hello, VERSION);
  put_string(&hello, link->plugin);
  put_string(&hello, files_seen(seen, sizeof seen));
  put_string(&hello, secure_getenv(TOKENS_MODULE));
  put_string(&hello, secure_getenv(TOKENS_PIN_FILE));
  bool good = !hello.failed && exchange(link, &hello, &answer, ex);
  if (good) {
    struct reader reader = {.data = answer.data, .left = answer.size};
    good = accepted(&reader, ex);
  }
  if (!good)
    drop(link);
  forget(&hello);
  forget(&answer);
  return good;
}

static int connect_to(const struct sockaddr_un *address)
{
  int found = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (found >= 0 && connect(found, (const struct sockaddr *)address, sizeof *address) != 0) {
    int code = errno;
    close(found);
    errno = code;
    return -1;
  }
  return found;
}

/* The process that listens there must run as the same user. */
static bool is_own(int socket)
{
  struct ucred peer;
  socklen_t size = sizeof peer;
  return getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0 && peer.uid == geteuid();
}

static void pause_for(long ms)
{
  nanosleep(&(struct timespec){.tv_nsec = ms * 1000000}, NULL);
}

static void unlock(int lock)
{
  if (lock >= 0)
    close(lock);
}

/* Whether the process that starts the agent has failed; `*starting` is 0 once it has ended. */
static bool has_failed(pid_t *starting)
{
  int status = 0;
  pid_t ended = *starting > 0 ? waitpid(*starting, &status, WNOHANG) : 0;
  if (ended != 0 && !(ended < 0 && errno == EINTR))
    *starting = 0; /* it has ended, or the host has waited for it */
  return ended > 0 && status != 0;
}

/* A connected socket, or -1 and why. One process starts the agent, and all others wait for it. */
static int reach(const struct sockaddr_un *address, struct exception *ex)
{
  int64_t deadline = now_ms() + AGENT_START_MS;
  pid_t starting = 0;
  int lock = -1;
  bool may_start = false, started = false, failed = false;
  for (;;) {
    int found = connect_to(address);
    bool absent = errno == ENOENT || errno == ECONNREFUSED;
    if (found >= 0) { /* the process that started it may end later than we connect */
      deadline = now_ms() + agent_patience_ms();
      while (has_failed(&starting), starting > 0 && now_ms() < deadline)
        pause_for(RETRY_MS);
      unlock(lock);
      return found;
    }
    if (failed) {
      refuse(ex, "pqsec: the agent cannot be started; `pqsec agent log` shows why");
      break;
    }
    if ((!absent && errno != EAGAIN) || now_ms() > deadline) {
      refuse(ex, "pqsec: the agent cannot be reached at %s (%s)%s", address->sun_path,
             strerror(errno), started ? "; `pqsec agent log` may show why" : "");
      break;
    }
    if (absent && !may_start) {
      may_start = agent_may_start(address->sun_path, &lock);
      if (may_start)
        continue; /* the process that had the lock before may have started it */
    } else if (absent && !started) {
      started = true;
      if ((starting = agent_start(address->sun_path, ex)) == 0)
        break;
    }
    pause_for(may_start ? RETRY_MS : OTHERS_RETRY_MS);
    failed = has_failed(&starting);
  }
  unlock(lock);
  return -1;
}

static bool connect_or_start(struct link *link, struct exception *ex)
{
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  if (!agent_place(address.sun_path, sizeof address.sun_path, ex))
    return false;
  link->socket = reach(&address, ex);
  if (link->socket >= 0 && !is_own(link->socket)) {
    refuse(ex, "pqsec: the agent at %s is another user's", address.sun_path);
    drop(link);
  }
  return link->socket >= 0;
}

static bool open_once(struct link *link, struct exception *ex)
{
  link->lost = false;
  return connect_or_start(link, ex) && greet(link, ex);
}

/* The agent only answers: octets between two calls are the end, or an error. */
static bool has_hung_up(const struct link *link)
{
  uint8_t octet;
  return link->socket >= 0 &&
         (recv(link->socket, &octet, 1, MSG_PEEK | MSG_DONTWAIT) >= 0 || errno != EAGAIN);
}

bool link_open(struct link *link, struct exception *ex)
{
  hold(link);
  if (has_hung_up(link))
    drop(link);
  bool open = link->socket >= 0 || open_once(link, ex);
  /* That agent was stopping, or cannot serve this host; the next try starts another. Hosts of other
   * kinds that start now may be faster, and then theirs is the next. */
  for (int tries = 1; !open && link->lost && tries < MOST_TRIES; tries++) {
    forgive(ex);
    open = open_once(link, ex);
  }
  pthread_mutex_unlock(&link->mutex);
  return open;
}

static const char *put_arguments(struct writer *w, const char *kinds, va_list *arguments)
{
  for (; *kinds != '>'; kinds++)
    switch (*kinds) {
    case 'h': put_u64(w, (uint64_t)va_arg(*arguments, handle_t)); break;
    case 'n': put_u32(w, (uint32_t)va_arg(*arguments, int32_t)); break;
    case 's': put_string(w, va_arg(*arguments, const char *)); break;
    case 't': put_token(w, va_arg(*arguments, const struct token *)); break;
    case 'g': put_raw(w, va_arg(*arguments, const struct guid *), sizeof(struct guid)); break;
    case 'p': put_strings(w, va_arg(*arguments, const struct strings *)); break;
    case 'd': put_tags(w, va_arg(*arguments, const struct tags *)); break;
    case 'q': put_properties(w, &va_arg(*arguments, const struct qos *)->properties); break;
    case 'o': {
      const struct octets *octets = va_arg(*arguments, const struct octets *);
      put_octets(w, octets->buffer, octets->length);
      break;
    }
    default: abort();
    }
  return kinds + 1;
}

static void get_results(struct reader *r, const char *kinds, va_list *results)
{
  for (; *kinds != '\0'; kinds++)
    switch (*kinds) {
    case 'h': *va_arg(*results, handle_t *) = (handle_t)get_u64(r); break;
    case 'x': *va_arg(*results, int64_t *) = (int64_t)get_u64(r); break;
    case 'b': *va_arg(*results, uint8_t *) = get_u8(r); break;
    case 'm': *va_arg(*results, uint32_t *) = get_u32(r); break;
    case 'g': get_raw(r, va_arg(*results, struct guid *), sizeof(struct guid)); break;
    case 'c': get_raw(r, va_arg(*results, uint8_t *), CHALLENGE); break;
    case 't': get_token(r, va_arg(*results, struct token *)); break;
    case 'o': get_octets(r, va_arg(*results, struct octets *)); break;
    default: abort();
    }
  r->failed = r->failed || r->left > 0;
}

/* Frees the values of an answer that is malformed. */
static void drop_results(const char *kinds, va_list *results)
{
  for (; *kinds != '\0'; kinds++)
    switch (*kinds) {
    case 't': free_token(va_arg(*results, struct token *)); break;
    case 'o': {
      struct octets *octets = va_arg(*results, struct octets *);
      if (octets->buffer != NULL)
        explicit_bzero(octets->buffer, octets->length);
      free(octets->buffer);
      *octets = (struct octets){0};
      break;
    }
    default: (void)va_arg(*results, void *);
    }
}

/* With the link's mutex: whether the connection is open. */
static bool usable(const struct link *link, struct exception *ex)
{
  if (link->socket >= 0)
    return true;
  refuse(ex, "pqsec: the agent was lost; create the participant again");
  return false;
}

int ask(struct link *link, struct exception *ex, const char *function, const char *kinds, ...)
{
  struct writer request = new_frame(), answer = {0};
  int result = -1;
  va_list arguments;
  va_start(arguments, kinds);
  put_string(&request, function);
  kinds = put_arguments(&request, kinds, &arguments);
  if (request.failed)
    refuse(ex, "pqsec: more than %d octets for %s", MAX_FRAME, function);
  hold(link);
  bool answered = !request.failed && usable(link, ex) && exchange(link, &request, &answer, ex);
  pthread_mutex_unlock(&link->mutex);
  struct reader reader = {.data = answer.data, .left = answer.size};
  if (answered && accepted(&reader, ex)) {
    va_list again;
    va_copy(again, arguments);
    result = (int)get_u32(&reader);
    get_results(&reader, kinds, &arguments);
    if (reader.failed || result < 0 || result == VALIDATION_FAILED || result > VALIDATION_LAST) {
      refuse(ex, "pqsec: the agent's answer to %s is malformed", function);
      drop_results(kinds, &again);
      result = -1;
    }
    va_end(again);
  }
  va_end(arguments);
  forget(&request);
  forget(&answer);
  return result;
}
