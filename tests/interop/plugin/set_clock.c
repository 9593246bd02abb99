/* The clock is set while the plugin's thread waits: back by a day, and forward by a day.
 *
 * The alarm ends who waits for the day to pass. */

#define _GNU_SOURCE
#include <stdint.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

enum { DAY = 86400 };

static volatile int64_t set_by;

static int64_t set_time(void)
{
  return (int64_t)time(NULL) + set_by;
}

static int set_clock(clockid_t which, struct timespec *now)
{
  int found = clock_gettime(which, now);
  if (which == CLOCK_REALTIME)
    now->tv_sec += set_by;
  return found;
}

#define clock_gettime set_clock
#define time(none) set_time()
#include "watch.c"

static volatile int told, looked;

static uint8_t hear(const void *plugin, handle_t handle)
{
  (void)plugin;
  told += handle == 7;
  return 1;
}

static void find(const void *plugin)
{
  (void)plugin;
  looked++;
}

int main(void)
{
  static struct watch set_back, set_forward;
  alarm(2 * LOOK_SECONDS + 2);
  watch_init(&set_back, NULL);
  watch_init(&set_forward, NULL);
  watch_tell(&set_forward, hear);
  watch_add(&set_forward, 7, set_time() + DAY / 2);
  set_by = DAY;
  while (told == 0)
    usleep(1000);
  watch_look(&set_back, find);
  usleep(100000); /* the thread waits */
  set_by = 0;
  while (looked == 0)
    usleep(1000);
  watch_end(&set_back);
  watch_end(&set_forward);
  puts("both");
  return 0;
}
