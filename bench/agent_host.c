/* A participant of Cyclone DDS for bench/agent.py that waits until it has met all others.
 *
 * usage: host DOMAIN HOSTS SECONDS
 *
 * Makes a participant with a writer and a reader of one topic, and waits so many seconds until both
 * are matched with those of all HOSTS, its own among them. On stdout a line each: `made
 * MILLISECONDS` or `refused`, and `full MILLISECONDS` or `short READERS WRITERS`; times since it
 * began. Then it ends when its stdin does.
 */

#include <dds/dds.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "Sample.h"

static double now_ms(void) { return (double)dds_time() / 1e6; }

static dds_entity_t good(dds_entity_t entity)
{
  if (entity < 0)
    exit(3);
  return entity;
}

int main(int words, char **word)
{
  if (words != 4)
    return 2;
  double start = now_ms();
  uint32_t hosts = (uint32_t)atoi(word[2]);
  dds_entity_t participant = dds_create_participant((dds_domainid_t)atoi(word[1]), NULL, NULL);
  if (participant < 0) {
    printf("refused\n");
    return 1;
  }
  printf("made %.2f\n", now_ms() - start);
  fflush(stdout);
  dds_entity_t topic =
      good(dds_create_topic(participant, &pqsec_Sample_desc, "rt/chatter", NULL, NULL));
  dds_entity_t writer = good(dds_create_writer(participant, topic, NULL, NULL));
  dds_entity_t reader = good(dds_create_reader(participant, topic, NULL, NULL));
  dds_publication_matched_status_t writes = {0};
  dds_subscription_matched_status_t reads = {0};
  double end = start + 1e3 * atoi(word[3]);
  while (now_ms() < end) {
    dds_get_publication_matched_status(writer, &writes);
    dds_get_subscription_matched_status(reader, &reads);
    if (writes.current_count >= hosts && reads.current_count >= hosts)
      break;
    dds_sleepfor(DDS_MSECS(20));
  }
  if (writes.current_count >= hosts && reads.current_count >= hosts)
    printf("full %.2f\n", now_ms() - start);
  else
    printf("short %u %u\n", writes.current_count, reads.current_count);
  fflush(stdout);
  while (getchar() != EOF)
    ;
  _exit(0); /* 0.10.2 may crash in its threads while a process with a participant exits */
}
