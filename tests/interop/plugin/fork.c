/* A host that forks while the plugin's thread runs and another makes a call: the child ends its
 * copies, the parent goes on.
 *
 * The alarm ends who waits for a thread that it does not have. */

#define _GNU_SOURCE
#include "link.c"
#include "watch.h"

int agent_patience_ms(void) { return 1000; }
bool agent_place(char *path, size_t size, struct exception *ex) { return path && size && !ex; }
bool agent_may_start(const char *path, int *lock) { return path && lock; }
pid_t agent_start(const char *path, struct exception *ex) { return path && ex; }
const char *files_seen(char *text, size_t size) { return size ? strcpy(text, "") : NULL; }

static struct watch watch;
static struct link connection;
static volatile int told;

static uint8_t tell(const void *plugin, handle_t handle)
{
  told += plugin == &watch && handle == 7;
  return 1;
}

static void wait_for(int count)
{
  while (told < count)
    usleep(1000);
}

int main(void)
{
  int status = -1;
  alarm(10);
  watch_init(&watch, &watch);
  watch_tell(&watch, tell);
  watch_add(&watch, 7, LONG_AGO);
  wait_for(1);
  watch_add(&watch, 8, time(NULL) + 1000); /* the thread waits */
  usleep(10000);
  int ends[2];
  link_init(&connection, "authentication");
  if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0)
    return 2;
  connection.socket = ends[0];
  pthread_mutex_lock(&connection.mutex); /* as in a call */
  pid_t child = fork();
  if (child == 0) {
    alarm(5);
    struct exception ex = {0};
    if (ask(&connection, &ex, "f", ">") != -1 || strstr(ex.message, "was lost") == NULL)
      _exit(3);
    free(ex.message);
    link_close(&connection);
    watch_remove(&watch, 8);
    watch_add(&watch, 7, LONG_AGO); /* a thread of the child's own */
    wait_for(2);
    watch_end(&watch);
    _exit(0);
  }
  if (waitpid(child, &status, 0) != child || status != 0)
    return 1;
  watch_add(&watch, 7, LONG_AGO);
  wait_for(2);
  watch_end(&watch);
  pthread_mutex_unlock(&connection.mutex);
  if (connection.socket != ends[0] || write(connection.socket, "x", 1) != 1)
    return 4;
  puts("both");
  return 0;
}
