/* A participant that says of another one: met, and lost.
 *
 * usage: neighbours DOMAIN SECONDS [PROPERTY VALUE]...
 *
 * It ends once the other is lost, or after SECONDS; with 3 if it cannot be made. With a + behind
 * SECONDS it stays when the other is lost. */

#include <dds/dds.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int is_own(dds_entity_t participant, const dds_guid_t *key)
{
  dds_guid_t own;
  return dds_get_guid(participant, &own) == DDS_RETCODE_OK && memcmp(&own, key, sizeof own) == 0;
}

int main(int words, char **word)
{
  dds_time_t end = dds_time() + DDS_SECS(words > 2 ? atoi(word[2]) : 0);
  int stays = words > 2 && strchr(word[2], '+') != NULL;
  dds_qos_t *qos = dds_create_qos();
  for (int at = 3; at + 1 < words; at += 2)
    dds_qset_prop(qos, word[at], word[at + 1]);
  dds_entity_t participant = dds_create_participant((dds_domainid_t)atoi(word[1]), qos, NULL);
  dds_delete_qos(qos);
  dds_entity_t reader =
      dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPARTICIPANT, NULL, NULL);
  if (participant < 0 || reader < 0)
    return 3;
  for (int lost = 0; (!lost || stays) && dds_time() < end; dds_sleepfor(DDS_MSECS(20))) {
    void *samples[1] = {NULL};
    dds_sample_info_t info[1];
    int count = dds_take(reader, samples, info, 1, 1);
    if (count <= 0)
      continue;
    const dds_builtintopic_participant_t *found = samples[0];
    if (!is_own(participant, &found->key)) {
      lost = info[0].instance_state != DDS_IST_ALIVE;
      puts(lost ? "lost" : "met");
      fflush(stdout);
    }
    dds_return_loan(reader, samples, count);
  }
  return dds_delete(participant) == DDS_RETCODE_OK ? 0 : 4;
}
