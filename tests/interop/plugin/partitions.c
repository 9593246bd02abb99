/* A participant with a writer, or a reader, in each of some partitions.
 *
 * usage: partitions send|receive DOMAIN TOPIC SECONDS PARTITION...
 *
 * A writer sends its partition, over and over. On stdout, a line each: "denied PARTITION" of what
 * its own stack does not make, and "got READER WRITER", with their partitions, of the first sample
 * of each pair. It ends after SECONDS. */

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>

#include "Sample.h"
#include "dds/dds.h"

#define MOST 32

static struct end {
  const char *partition;
  dds_entity_t entity;
  char *known[MOST];
} ends[MOST];

static dds_entity_t made(dds_entity_t participant, dds_entity_t topic, const char *partition,
                         int sends)
{
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, 0);
  dds_qset_partition1(qos, partition);
  dds_entity_t group = sends ? dds_create_publisher(participant, qos, NULL)
                             : dds_create_subscriber(participant, qos, NULL);
  return sends ? dds_create_writer(group, topic, qos, NULL)
               : dds_create_reader(group, topic, qos, NULL);
}

static void tell(struct end *reader, const char *text)
{
  int known = 0;
  while (known < MOST && reader->known[known] && strcmp(reader->known[known], text) != 0)
    known++;
  if (known < MOST && !reader->known[known]) {
    reader->known[known] = strdup(text);
    printf("got %s %s\n", reader->partition, text);
  }
}

static void take(struct end *reader)
{
  void *samples[MOST] = {NULL};
  dds_sample_info_t info[MOST];
  int count = dds_take(reader->entity, samples, info, MOST, MOST);
  for (int each = 0; each < count; each++)
    if (info[each].valid_data)
      tell(reader, ((pqsec_Sample *)samples[each])->text);
  if (count > 0)
    dds_return_loan(reader->entity, samples, count);
}

int main(int words, char **word)
{
  if (words < 6 || words - 5 > MOST)
    return 2;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  int sends = strcmp(word[1], "send") == 0;
  dds_time_t end = dds_time() + DDS_SECS(atoi(word[4]));
  dds_entity_t participant = dds_create_participant((dds_domainid_t)atoi(word[2]), NULL, NULL);
  dds_entity_t topic = dds_create_topic(participant, &pqsec_Sample_desc, word[3], NULL, NULL);
  if (participant < 0 || topic < 0)
    return 3;
  for (int each = 0; each < words - 5; each++) {
    ends[each] = (struct end){.partition = word[each + 5]};
    ends[each].entity = made(participant, topic, word[each + 5], sends);
    if (ends[each].entity < 0)
      printf("denied %s\n", word[each + 5]);
  }
  for (; dds_time() < end; dds_sleepfor(DDS_MSECS(100))) {
    for (int each = 0; each < words - 5; each++) {
      pqsec_Sample sample = {(char *)ends[each].partition};
      if (ends[each].entity > 0 && sends)
        dds_write(ends[each].entity, &sample);
      else if (ends[each].entity > 0)
        take(&ends[each]);
    }
    fflush(stdout);
  }
  _Exit(0);
}
