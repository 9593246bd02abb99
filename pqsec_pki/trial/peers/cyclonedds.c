/* A participant of Cyclone DDS that sends or receives one text, or meets many others.
 *
 * usage: peer send|receive DOMAIN TOPIC TEXT SECONDS
 *        peer host DOMAIN TOPIC TEXT SECONDS          see cyclonedds_host.h
 *
 * Its configuration is the one that CYCLONEDDS_URI names. On stdout it says how far it came, a
 * line each: joined, created (its writer or reader), matched, received TEXT, or
 * refused WHAT: REASON. The stack's own messages go where the configuration says. It ends when it
 * has received, or after SECONDS.
 */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>

#include "Sample.h"
#include "dds/dds.h"

#define PAUSE DDS_MSECS(50)

static void say(const char *what, const char *more) {
  printf("%s%s\n", what, more);
  fflush(stdout);
}

/* The entity, or the end: the stack refused to make it. */
static dds_entity_t made(dds_entity_t entity, const char *what) {
  if (entity >= 0) return entity;
  printf("refused %s: %s\n", what, dds_strretcode(-entity));
  fflush(stdout);
  exit(3);
}

static void send_until(dds_entity_t writer, char *text, dds_time_t end) {
  pqsec_Sample sample = {text};
  int matched = 0;
  say("created", "");
  while (dds_time() < end) {
    dds_publication_matched_status_t status;
    dds_get_publication_matched_status(writer, &status);
    if (status.current_count > 0 && !matched) {
      matched = 1;
      say("matched", "");
    }
    dds_write(writer, &sample);
    dds_sleepfor(PAUSE);
  }
}

static void receive_until(dds_entity_t reader, dds_time_t end) {
  say("created", "");
  while (dds_time() < end) {
    void *samples[1] = {NULL};
    dds_sample_info_t info[1];
    int count = dds_take(reader, samples, info, 1, 1);
    if (count > 0 && info[0].valid_data) {
      say("received ", ((pqsec_Sample *)samples[0])->text);
      return;
    }
    if (count > 0) dds_return_loan(reader, samples, count);
    dds_sleepfor(PAUSE);
  }
}

#include "cyclonedds_host.h"

int main(int count, char **words) {
  if (count != 6) return 2;
  prctl(PR_SET_PDEATHSIG, SIGKILL); /* nobody is left to end it */
  dds_time_t end = dds_time() + (dds_time_t)(atof(words[5]) * 1e9);
  if (strcmp(words[1], "host") == 0) await_go();
  dds_entity_t participant = made(dds_create_participant(atoi(words[2]), NULL, NULL), "participant");
  say("joined", "");
  dds_entity_t topic =
      made(dds_create_topic(participant, &pqsec_Sample_desc, words[3], NULL, NULL), "topic");
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_durability(qos, DDS_DURABILITY_TRANSIENT_LOCAL);
  if (strcmp(words[1], "host") == 0) {
    host(participant, topic, words[4]);
    _Exit(0);
  }
  if (strcmp(words[1], "send") == 0)
    send_until(made(dds_create_writer(participant, topic, qos, NULL), "writer"), words[4], end);
  else
    receive_until(made(dds_create_reader(participant, topic, qos, NULL), "reader"), end);
  _Exit(0); /* what a stack does as it ends is no matter here */
}
