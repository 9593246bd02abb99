/* Says where the library looks for the agent: the socket, or why there is none. */

#define _GNU_SOURCE
#include "agent.h"

#include <stdio.h>
#include <stdlib.h>

int main(void)
{
  char path[108];
  struct exception ex = {0};
  bool found = agent_place(path, sizeof path, &ex);
  puts(found ? path : ex.message);
  free(ex.message);
  return !found;
}
