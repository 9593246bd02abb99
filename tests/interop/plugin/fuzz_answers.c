/* Answers of an agent that has gone mad: the shim refuses them, and nothing worse.
 *
 * usage: fuzz_answers COUNT SEED
 *
 * Each answer is a good one, spoilt, that already waits in the socket when the call is made.
 * Compiled with sanitizers; says how many were taken and how many refused. */

#define _GNU_SOURCE
#include "link.c"

int agent_patience_ms(void) { return 1000; }
bool agent_place(char *path, size_t size, struct exception *ex) { return path && size && ex; }
bool agent_may_start(const char *path, int *lock) { return path && lock; }
pid_t agent_start(const char *path, struct exception *ex) { return path && ex; }
const char *files_seen(char *text, size_t size) { return size ? strcpy(text, "") : NULL; }

static uint64_t state;

static uint32_t chance(uint32_t below)
{
  state ^= state << 13;
  state ^= state >> 7;
  state ^= state << 17;
  return (uint32_t)(state >> 11) % below;
}

static const char *const KINDS[] = {">hgxb", ">t", ">", ">ht", ">hxcco", ">b", ">bbbbbbbm"};
enum { LONGEST = 300 };

static void put_noise(struct writer *w, uint32_t most)
{
  uint8_t noise[LONGEST];
  uint32_t size = chance(most);
  for (uint32_t i = 0; i < size; i++)
    noise[i] = (uint8_t)chance(256);
  put_octets(w, noise, size);
}

static void put_some_token(struct writer *w)
{
  put_noise(w, 40);
  uint32_t count = chance(4);
  put_u32(w, count);
  for (uint32_t i = 0; i < 2 * count; i++)
    put_noise(w, LONGEST);
  count = chance(4);
  put_u32(w, count);
  for (uint32_t i = 0; i < 2 * count; i++)
    put_noise(w, LONGEST);
}

static void put_answer(struct writer *w, const char *kinds)
{
  put_u8(w, chance(8) == 0);
  put_u32(w, chance(7));
  for (; *kinds != '\0'; kinds++)
    switch (*kinds) {
    case 'h': case 'x': put_u64(w, state); break;
    case 'b': put_u8(w, (uint8_t)chance(256)); break;
    case 'm': put_u32(w, chance(1 << 30)); break;
    case 'g': put_raw(w, KINDS, 16); break;
    case 'c': put_raw(w, KINDS, 32); break;
    case 'o': put_noise(w, LONGEST); break;
    case 't': put_some_token(w); break;
    }
}

static void spoil(struct writer *w)
{
  for (uint32_t i = chance(4); i > 0 && w->size > 0; i--)
    w->data[chance((uint32_t)w->size)] = chance(2) ? (uint8_t)chance(256) : 0xff;
  if (chance(4) == 0)
    w->size = chance((uint32_t)w->size + 1);
}

/* What the agent sends: a frame, whose length may be wrong, and then the end. */
static void answer(int socket, const char *kinds)
{
  struct writer body = {0}, frame = {0};
  put_answer(&body, kinds);
  spoil(&body);
  put_u32(&frame, (uint32_t)body.size);
  if (chance(16) == 0)
    frame.data[chance(4)] = (uint8_t)chance(256);
  put_raw(&frame, body.data, body.size);
  if (send(socket, frame.data, frame.size, 0) != (ssize_t)frame.size)
    abort();
  shutdown(socket, SHUT_WR);
  forget(&body);
  forget(&frame);
}

static int call(struct link *link, struct exception *ex, const char *kinds)
{
  handle_t handle;
  struct guid guid;
  int64_t end;
  uint8_t bytes[7], challenges[2][32];
  uint32_t mask;
  struct token token = {0};
  struct octets octets = {0};
  int result = -1;
  if (strcmp(kinds, ">hgxb") == 0)
    result = ask(link, ex, "f", kinds, &handle, &guid, &end, bytes);
  else if (strcmp(kinds, ">t") == 0)
    result = ask(link, ex, "f", kinds, &token);
  else if (strcmp(kinds, ">") == 0)
    result = ask(link, ex, "f", kinds);
  else if (strcmp(kinds, ">ht") == 0)
    result = ask(link, ex, "f", kinds, &handle, &token);
  else if (strcmp(kinds, ">hxcco") == 0)
    result = ask(link, ex, "f", kinds, &handle, &end, challenges[0], challenges[1], &octets);
  else if (strcmp(kinds, ">b") == 0)
    result = ask(link, ex, "f", kinds, bytes);
  else
    result = ask(link, ex, "f", kinds, bytes, bytes + 1, bytes + 2, bytes + 3, bytes + 4,
                 bytes + 5, bytes + 6, &mask);
  if (result < 0 && (token.class_id != NULL || octets.buffer != NULL))
    abort(); /* who is refused frees nothing */
  free_token(&token);
  free(octets.buffer);
  return result;
}

int main(int count, char **words)
{
  long taken = 0, refused = 0, runs = count == 3 ? atol(words[1]) : 0;
  state = 88172645463325252u ^ (count == 3 ? strtoull(words[2], NULL, 10) : 0);
  struct link link;
  link_init(&link, "authentication");
  for (long i = 0; i < runs; i++) {
    int ends[2];
    struct exception ex = {0};
    const char *kinds = KINDS[chance(sizeof KINDS / sizeof *KINDS)];
    if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0)
      abort();
    link.socket = ends[0];
    link.process = getpid();
    answer(ends[1], kinds + 1);
    int result = call(&link, &ex, kinds);
    if (result < 0 ? ex.message == NULL || ex.code == 0 : ex.message != NULL)
      abort(); /* a refusal has words, and nothing else has */
    *(result < 0 ? &refused : &taken) += 1;
    free(ex.message);
    link_close(&link);
    close(ends[1]);
  }
  printf("%ld taken, %ld refused\n", taken, refused);
  return 0;
}
