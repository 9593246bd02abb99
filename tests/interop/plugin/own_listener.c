/* A listener that takes itself away while it is called, as who deletes a participant may.
 *
 * The alarm ends the program if that waits for itself. */

#define _GNU_SOURCE
#include "watch.h"

#include <stdio.h>
#include <time.h>
#include <unistd.h>

static struct watch watch;
static volatile int told;

static uint8_t leave(const void *plugin, handle_t handle)
{
  watch_tell(&watch, NULL);
  told += plugin == &watch && handle == 7;
  return 1;
}

int main(void)
{
  alarm(5);
  watch_init(&watch, &watch);
  watch_tell(&watch, leave);
  watch_add(&watch, 7, time(NULL) - 1);
  watch_add(&watch, 8, time(NULL) - 1);
  while (told == 0)
    usleep(1000);
  watch_end(&watch);
  printf("%d\n", told);
  return 0;
}
