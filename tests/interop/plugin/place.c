/* Says where the library looks for the agent: the socket, or why there is none. With a word, it
 * starts an agent there, or says why not. */

#define _GNU_SOURCE
#include "agent.h"

#include <stdio.h>
#include <stdlib.h>

int main(int words, char **word)
{
  (void)word;
  char path[108];
  struct exception ex = {0};
  bool found = agent_place(path, sizeof path, &ex) && (words < 2 || agent_start(path, &ex) > 0);
  puts(found ? path : ex.message);
  free(ex.message);
  return !found;
}
