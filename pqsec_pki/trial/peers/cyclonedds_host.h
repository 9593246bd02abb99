/* Included by cyclonedds.c: a participant that meets all others of a network.
 *
 * It says `ready`, and waits for a line on stdin before it creates its participant. Then it says
 * `joined T`, and `writer N T` or `reader N T` when the number of endpoints that its writer or
 * reader is matched with changes, its own among them. T is in seconds of CLOCK_MONOTONIC. A
 * further line `N` on stdin makes it write N samples with its TEXT, after which it says `sent N`;
 * at `0` it says `received N`, the samples of others until then. It ends when stdin does.
 */
#include <time.h>

#define HOST_PAUSE DDS_MSECS(50)
#define HOST_DEPTH 10 /* of ROS 2's default QoS */

static const char *host_name;
static volatile long host_received;

static double monotonic(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

static void await_go(void) {
  char line[32];
  say("ready", "");
  if (fgets(line, sizeof line, stdin) == NULL) _Exit(0);
}

static void tell(const char *what, long count) {
  printf("%s %ld %.6f\n", what, count, monotonic());
  fflush(stdout);
}

static void on_writer(dds_entity_t writer, const dds_publication_matched_status_t status, void *to) {
  (void)writer, (void)to;
  tell("writer", status.current_count);
}

static void on_reader(dds_entity_t reader, const dds_subscription_matched_status_t status, void *to) {
  (void)reader, (void)to;
  tell("reader", status.current_count);
}

static void on_data(dds_entity_t reader, void *to) {
  void *samples[1] = {NULL};
  dds_sample_info_t info[1];
  int count;
  (void)to;
  while ((count = dds_take(reader, samples, info, 1, 1)) > 0) {
    if (info[0].valid_data && strcmp(((pqsec_Sample *)samples[0])->text, host_name) != 0)
      host_received++;
    dds_return_loan(reader, samples, count);
  }
}

static void write_samples(dds_entity_t writer, long count) {
  pqsec_Sample sample = {(char *)host_name};
  for (long i = 0; i < count; i++) {
    dds_write(writer, &sample);
    dds_sleepfor(HOST_PAUSE);
  }
  tell("sent", count);
}

static void host(dds_entity_t participant, dds_entity_t topic, const char *name) {
  tell("joined", 0);
  host_name = name;
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, HOST_DEPTH);
  dds_listener_t *listener = dds_create_listener(NULL);
  dds_lset_publication_matched(listener, on_writer);
  dds_lset_subscription_matched(listener, on_reader);
  dds_lset_data_available(listener, on_data);
  dds_entity_t writer = made(dds_create_writer(participant, topic, qos, listener), "writer");
  made(dds_create_reader(participant, topic, qos, listener), "reader");
  char line[32];
  while (fgets(line, sizeof line, stdin) != NULL)
    if (atol(line) > 0)
      write_samples(writer, atol(line));
    else
      tell("received", host_received);
}
