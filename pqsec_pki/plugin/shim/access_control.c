/* The access control plugin: DDS-Security 1.1, 8.4.2.9. The agent answers calls that need a
 * decision; the others are answered here. Cyclone DDS calls at discovery, never for a sample. */

#define _GNU_SOURCE
#include <string.h>

#include "plugin.h"

/* How a topic's endpoints are protected. It does not change while the handle is valid, and Cyclone
 * DDS asks for it for six topics of its own, each time a participant is created. */
struct known {
  struct known *next;
  handle_t permissions;
  struct endpoint_attributes attributes;
  char topic[];
};

struct plugin {
  struct access_control functions; /* first: Cyclone DDS uses our address as that of the table */
  struct link link;
  struct watch watch;
  pthread_mutex_t mutex;
  struct known *known;
};

static handle_t validate_local_permissions(struct plugin *self, const void *authentication,
                                           handle_t identity, int32_t domain,
                                           const struct qos *qos, struct exception *ex)
{
  char folder[MAX_PATH];
  handle_t permissions;
  int64_t end;
  (void)authentication;
  if (!working_folder(folder, sizeof folder, ex) || !link_open(&self->link, ex))
    return 0;
  if (ask(&self->link, ex, "validate_local_permissions", "hnsq>hx", identity, domain, folder, qos,
          &permissions, &end) < 0)
    return 0;
  watch_add(&self->watch, permissions, end);
  return permissions;
}

static handle_t validate_remote_permissions(struct plugin *self, const void *authentication,
                                            handle_t identity, handle_t peer,
                                            const struct token *permissions_token,
                                            const struct token *credential, struct exception *ex)
{
  handle_t permissions;
  int64_t end;
  (void)authentication;
  if (ask(&self->link, ex, "validate_remote_permissions", "hhtt>hx", identity, peer,
          permissions_token, credential, &permissions, &end) < 0)
    return 0;
  watch_add(&self->watch, permissions, end);
  return permissions;
}

static uint8_t check_create_participant(struct plugin *self, handle_t permissions, int32_t domain,
                                        const struct qos *qos, struct exception *ex)
{
  (void)qos;
  return ask(&self->link, ex, "check_create_participant", "hn>", permissions, domain) >= 0;
}

static uint8_t check_create_datawriter(struct plugin *self, handle_t permissions, int32_t domain,
                                       const char *topic, const struct qos *qos,
                                       const struct strings *partition, const struct tags *tags,
                                       struct exception *ex)
{
  (void)qos;
  return ask(&self->link, ex, "check_create_datawriter", "hnspd>", permissions, domain, topic,
             partition, tags) >= 0;
}

static uint8_t check_create_datareader(struct plugin *self, handle_t permissions, int32_t domain,
                                       const char *topic, const struct qos *qos,
                                       const struct strings *partition, const struct tags *tags,
                                       struct exception *ex)
{
  (void)qos;
  return ask(&self->link, ex, "check_create_datareader", "hnspd>", permissions, domain, topic,
             partition, tags) >= 0;
}

static uint8_t check_create_topic(struct plugin *self, handle_t permissions, int32_t domain,
                                  const char *topic, const struct qos *qos, struct exception *ex)
{
  (void)qos;
  return ask(&self->link, ex, "check_create_topic", "hns>", permissions, domain, topic) >= 0;
}

static uint8_t check_remote_participant(struct plugin *self, handle_t permissions, int32_t domain,
                                        const void *data, struct exception *ex)
{
  (void)data;
  return ask(&self->link, ex, "check_remote_participant", "hn>", permissions, domain) >= 0;
}

static uint8_t check_remote_datawriter(struct plugin *self, handle_t permissions, int32_t domain,
                                       const struct publication *data, struct exception *ex)
{
  return ask(&self->link, ex, "check_remote_datawriter", "hnspd>", permissions, domain,
             data->topic, &data->partition, &data->tags) >= 0;
}

static uint8_t check_remote_datareader(struct plugin *self, handle_t permissions, int32_t domain,
                                       const struct subscription *data, uint8_t *relay_only,
                                       struct exception *ex)
{
  return ask(&self->link, ex, "check_remote_datareader", "hnspd>b", permissions, domain,
             data->topic, &data->partition, &data->tags, relay_only) >= 0;
}

static uint8_t check_remote_topic(struct plugin *self, handle_t permissions, int32_t domain,
                                  const struct topic *data, struct exception *ex)
{
  return ask(&self->link, ex, "check_remote_topic", "hns>", permissions, domain, data->name) >= 0;
}

/* Permissions documents do not restrict instances and matches. Each of these functions has other
 * arguments; none is read, and the exception is not changed. */
static uint8_t allow(void) { return true; }

static uint8_t get_permissions_token(struct plugin *self, struct token *token,
                                     handle_t permissions, struct exception *ex)
{
  return ask(&self->link, ex, "get_permissions_token", "h>t", permissions, token) >= 0;
}

static uint8_t get_permissions_credential_token(struct plugin *self, struct token *token,
                                                handle_t permissions, struct exception *ex)
{
  return ask(&self->link, ex, "get_permissions_credential_token", "h>t", permissions, token) >= 0;
}

static uint8_t set_listener(struct plugin *self, const struct listener *listener,
                            struct exception *ex)
{
  (void)ex;
  watch_tell(&self->watch, listener != NULL ? listener->on_revoke : NULL);
  return true;
}

static uint8_t return_token(struct plugin *self, struct token *token, struct exception *ex)
{
  (void)self, (void)ex;
  free_token(token);
  return true;
}

static uint8_t get_participant_sec_attributes(struct plugin *self, handle_t permissions,
                                              struct participant_attributes *into,
                                              struct exception *ex)
{
  *into = (struct participant_attributes){0};
  return ask(&self->link, ex, "get_participant_sec_attributes", "h>bbbbbm", permissions,
             &into->unauthenticated, &into->access, &into->rtps, &into->discovery,
             &into->liveliness, &into->plugin) >= 0;
}

static uint8_t get_topic_sec_attributes(struct plugin *self, handle_t permissions,
                                        const char *topic, struct topic_attributes *into,
                                        struct exception *ex)
{
  *into = (struct topic_attributes){0};
  return ask(&self->link, ex, "get_topic_sec_attributes", "hs>bbbb", permissions, topic,
             &into->read, &into->write, &into->discovery, &into->liveliness) >= 0;
}

static bool recall(struct plugin *self, handle_t permissions, const char *topic,
                   struct endpoint_attributes *into)
{
  bool found = false;
  pthread_mutex_lock(&self->mutex);
  for (const struct known *each = self->known; each != NULL && !found; each = each->next)
    if (each->permissions == permissions && strcmp(each->topic, topic) == 0) {
      *into = each->attributes;
      found = true;
    }
  pthread_mutex_unlock(&self->mutex);
  return found;
}

static void remember(struct plugin *self, handle_t permissions, const char *topic,
                     const struct endpoint_attributes *attributes)
{
  struct known *fresh = calloc(1, sizeof *fresh + strlen(topic) + 1);
  if (fresh == NULL)
    return;
  fresh->permissions = permissions;
  fresh->attributes = *attributes;
  strcpy(fresh->topic, topic);
  pthread_mutex_lock(&self->mutex);
  fresh->next = self->known;
  self->known = fresh;
  pthread_mutex_unlock(&self->mutex);
}

static void forget_known(struct plugin *self, handle_t permissions, bool all)
{
  pthread_mutex_lock(&self->mutex);
  for (struct known **at = &self->known; *at != NULL;) {
    struct known *found = *at;
    if (all || found->permissions == permissions) {
      *at = found->next;
      free(found);
    } else {
      at = &found->next;
    }
  }
  pthread_mutex_unlock(&self->mutex);
}

static uint8_t get_endpoint_sec_attributes(struct plugin *self, handle_t permissions,
                                           const char *topic, const struct strings *partition,
                                           const struct tags *tags,
                                           struct endpoint_attributes *into, struct exception *ex)
{
  (void)partition, (void)tags; /* governance has rules for topics only */
  if (recall(self, permissions, topic, into))
    return true;
  *into = (struct endpoint_attributes){0};
  bool found = ask(&self->link, ex, "get_endpoint_sec_attributes", "hs>bbbbbbbm", permissions,
                   topic, &into->read, &into->write, &into->discovery, &into->liveliness,
                   &into->submessage, &into->payload, &into->key, &into->plugin) >= 0;
  if (found)
    remember(self, permissions, topic, into);
  return found;
}

/* This succeeds even if the agent has ended. */
static uint8_t return_permissions_handle(struct plugin *self, handle_t permissions,
                                         struct exception *ex)
{
  (void)ex;
  watch_remove(&self->watch, permissions);
  forget_known(self, permissions, false);
  ask(&self->link, NULL, "return_permissions_handle", "h>", permissions);
  return true;
}

EXPORT int init_access_control(const char *argument, void **context, void *domain)
{
  (void)argument;
  struct plugin *self = *context = calloc(1, sizeof *self);
  if (self == NULL)
    return -1;
  self->functions = (struct access_control){
      .domain = domain,
      .validate_local_permissions = (function)validate_local_permissions,
      .validate_remote_permissions = (function)validate_remote_permissions,
      .check_create_participant = (function)check_create_participant,
      .check_create_datawriter = (function)check_create_datawriter,
      .check_create_datareader = (function)check_create_datareader,
      .check_create_topic = (function)check_create_topic,
      .check_local_datawriter_register_instance = (function)allow,
      .check_local_datawriter_dispose_instance = (function)allow,
      .check_remote_participant = (function)check_remote_participant,
      .check_remote_datawriter = (function)check_remote_datawriter,
      .check_remote_datareader = (function)check_remote_datareader,
      .check_remote_topic = (function)check_remote_topic,
      .check_local_datawriter_match = (function)allow,
      .check_local_datareader_match = (function)allow,
      .check_remote_datawriter_register_instance = (function)allow,
      .check_remote_datawriter_dispose_instance = (function)allow,
      .get_permissions_token = (function)get_permissions_token,
      .get_permissions_credential_token = (function)get_permissions_credential_token,
      .set_listener = (function)set_listener,
      .return_permissions_token = (function)return_token,
      .return_permissions_credential_token = (function)return_token,
      .get_participant_sec_attributes = (function)get_participant_sec_attributes,
      .get_topic_sec_attributes = (function)get_topic_sec_attributes,
      .get_datawriter_sec_attributes = (function)get_endpoint_sec_attributes,
      .get_datareader_sec_attributes = (function)get_endpoint_sec_attributes,
      .return_participant_sec_attributes = (function)allow,
      .return_topic_sec_attributes = (function)allow,
      .return_datawriter_sec_attributes = (function)allow,
      .return_datareader_sec_attributes = (function)allow,
      .return_permissions_handle = (function)return_permissions_handle,
  };
  link_init(&self->link, "access_control");
  watch_init(&self->watch, self);
  pthread_mutex_init(&self->mutex, NULL);
  return 0;
}

EXPORT int finalize_access_control(void *context)
{
  struct plugin *self = context;
  watch_end(&self->watch);
  link_close(&self->link);
  forget_known(self, 0, true);
  free(self);
  return 0;
}
