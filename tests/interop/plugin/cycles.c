/* Participants that come and go: each loads the plugins, may meet a peer, and unloads them.
 *
 * usage: cycles DOMAIN COUNT MILLISECONDS
 *
 * Says how many kilobytes of memory the process had after a third of the cycles, and at the end.
 */

#include <dds/dds.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static long resident(void)
{
  char line[256];
  long found = 0;
  FILE *status = fopen("/proc/self/status", "r");
  while (status != NULL && fgets(line, sizeof line, status) != NULL)
    if (strncmp(line, "VmRSS:", 6) == 0)
      found = atol(line + 6);
  if (status != NULL)
    fclose(status);
  return found;
}

int main(int words, char **word)
{
  int count = words == 4 ? atoi(word[2]) : 0;
  for (int i = 0; i < count; i++) {
    dds_entity_t participant = dds_create_participant((dds_domainid_t)atoi(word[1]), NULL, NULL);
    if (participant < 0)
      return 3;
    dds_sleepfor(DDS_MSECS(atoi(word[3])));
    if (dds_delete(participant) != DDS_RETCODE_OK)
      return 4;
    if (i + 1 == (count + 2) / 3 || i + 1 == count)
      printf("%ld\n", resident());
  }
  return 0;
}
