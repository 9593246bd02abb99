/* Asks the agent where the library looks for it, and says the result, or why there is none. */

#define _GNU_SOURCE
#include "link.h"

#include <stdio.h>
#include <stdlib.h>

int main(void)
{
  struct link link;
  struct exception ex = {0};
  handle_t found = 0;
  link_init(&link, "authentication");
  if (link_open(&link, &ex) && ask(&link, &ex, "find_revoked", ">h", &found) == 0)
    printf("%lld\n", (long long)found);
  else
    puts(ex.message);
  free(ex.message);
  return 0;
}
