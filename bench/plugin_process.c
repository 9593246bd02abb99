/* A participant of Cyclone DDS for bench/plugin_process.py: what it takes to be made, and to be matched.
 *
 * usage: host write|read DOMAIN COUNT SECONDS
 *
 * Makes COUNT participants, the first of them with an endpoint; on stdout a line each:
 * `made MILLISECONDS KILOBYTES` for the first participant, `more MILLISECONDS` for one of the
 * others, and `matched MILLISECONDS KILOBYTES` since all were made. Kilobytes are private to the
 * process. Ends when its stdin does.
 */

#include <dds/dds.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "Sample.h"

static double now_ms(void) { return (double)dds_time() / 1e6; }

static long private_kilobytes(void)
{
  char line[256];
  long sum = 0, found;
  FILE *file = fopen("/proc/self/smaps_rollup", "r");
  while (file != NULL && fgets(line, sizeof line, file) != NULL)
    if (sscanf(line, "Private_Clean: %ld", &found) == 1 ||
        sscanf(line, "Private_Dirty: %ld", &found) == 1)
      sum += found;
  if (file != NULL)
    fclose(file);
  return sum;
}

static dds_entity_t good(dds_entity_t entity)
{
  if (entity < 0)
    exit(3);
  return entity;
}

int main(int words, char **word)
{
  if (words != 5)
    return 2;
  dds_domainid_t domain = (dds_domainid_t)atoi(word[2]);
  int count = atoi(word[3]), write = strcmp(word[1], "write") == 0;
  double start = now_ms();
  dds_entity_t participant = good(dds_create_participant(domain, NULL, NULL));
  printf("made %.2f %ld\n", now_ms() - start, private_kilobytes());
  start = now_ms();
  for (int i = 1; i < count; i++)
    good(dds_create_participant(domain, NULL, NULL));
  if (count > 1)
    printf("more %.3f\n", (now_ms() - start) / (count - 1));
  dds_entity_t topic =
      good(dds_create_topic(participant, &pqsec_Sample_desc, "rt/chatter", NULL, NULL));
  dds_entity_t endpoint = good(write ? dds_create_writer(participant, topic, NULL, NULL)
                                     : dds_create_reader(participant, topic, NULL, NULL));
  dds_set_status_mask(endpoint, write ? DDS_PUBLICATION_MATCHED_STATUS
                                      : DDS_SUBSCRIPTION_MATCHED_STATUS);
  dds_entity_t set = good(dds_create_waitset(participant));
  dds_waitset_attach(set, endpoint, 0);
  start = now_ms();
  printf("ready\n");
  fflush(stdout);
  if (dds_waitset_wait(set, NULL, 0, DDS_SECS(atoi(word[4]))) > 0)
    printf("matched %.2f %ld\n", now_ms() - start, private_kilobytes());
  fflush(stdout);
  while (getchar() != EOF)
    ;
  return 0;
}
