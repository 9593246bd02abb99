/* The authentication plugin: DDS-Security 1.1, 8.3.2.7. The agent answers calls that need
 * a decision; the others are answered here. */

#define _GNU_SOURCE
#include <string.h>

#include "plugin.h"

struct secret { struct secret *next; handle_t peer; struct shared_secret value; };

struct plugin {
  struct authentication functions; /* first: Cyclone DDS uses our address as that of the table */
  struct link link;
  struct watch watch;
  pthread_mutex_t mutex;
  struct secret *secrets; /* in use by the crypto plugin until the peer's handle is returned */
};

/* A refusal is a failed validation. */
static int validation(int result) { return result < 0 ? VALIDATION_FAILED : result; }

/* The watch calls it: adds identities that a newer revocation list of the agent revokes. */
static void find_revoked(const void *plugin)
{
  struct plugin *self = (struct plugin *)(uintptr_t)plugin;
  handle_t found = 0;
  for (int i = 0; i < MAX_ITEMS; i++) {
    if (ask(&self->link, NULL, "find_revoked", ">h", &found) < 0 || found == 0)
      return;
    watch_add(&self->watch, found, LONG_AGO);
  }
}

static int validate_local_identity(struct plugin *self, handle_t *identity, struct guid *adjusted,
                                   int32_t domain, const struct qos *qos,
                                   const struct guid *candidate, struct exception *ex)
{
  char folder[MAX_PATH];
  int64_t end;
  uint8_t has_list;
  if (!working_folder(folder, sizeof folder, ex) || !link_open(&self->link, ex))
    return VALIDATION_FAILED;
  int result = ask(&self->link, ex, "validate_local_identity", "nsqg>hgxb", domain, folder, qos,
                   candidate, identity, adjusted, &end, &has_list);
  if (result == VALIDATION_OK)
    watch_add(&self->watch, *identity, end);
  if (result == VALIDATION_OK && has_list)
    watch_look(&self->watch, find_revoked);
  return validation(result);
}

static uint8_t get_identity_token(struct plugin *self, struct token *token, handle_t identity,
                                  struct exception *ex)
{
  return ask(&self->link, ex, "get_identity_token", "h>t", identity, token) >= 0;
}

static uint8_t get_identity_status_token(struct plugin *self, struct token *token,
                                         handle_t identity, struct exception *ex)
{
  (void)self, (void)token, (void)identity, (void)ex;
  return true; /* there is none, as in Cyclone's own */
}

static uint8_t set_permissions_credential_and_token(struct plugin *self, handle_t identity,
                                                    const struct token *credential,
                                                    const struct token *permissions,
                                                    struct exception *ex)
{
  return ask(&self->link, ex, "set_permissions_credential_and_token", "htt>", identity, credential,
             permissions) >= 0;
}

static int validate_remote_identity(struct plugin *self, handle_t *peer,
                                    struct token *auth_request, const struct token *peers_request,
                                    handle_t identity, const struct token *peers_identity,
                                    const struct guid *guid, struct exception *ex)
{
  int result = ask(&self->link, ex, "validate_remote_identity", "thtg>ht", peers_request, identity,
                   peers_identity, guid, peer, auth_request);
  if (result < 0) /* Cyclone reads the class id of a token that it did not get */
    *auth_request = (struct token){.class_id = calloc(1, 1)};
  return validation(result);
}

static int begin_handshake_request(struct plugin *self, handle_t *handshake, struct token *request,
                                   handle_t identity, handle_t peer, const struct octets *data,
                                   struct exception *ex)
{
  return validation(ask(&self->link, ex, "begin_handshake_request", "hho>ht", identity, peer, data,
                        handshake, request));
}

static int begin_handshake_reply(struct plugin *self, handle_t *handshake, struct token *reply,
                                 const struct token *request, handle_t peer, handle_t identity,
                                 const struct octets *data, struct exception *ex)
{
  return validation(ask(&self->link, ex, "begin_handshake_reply", "thho>ht", request, peer,
                        identity, data, handshake, reply));
}

static int process_handshake(struct plugin *self, struct token *answer,
                             const struct token *message, handle_t handshake,
                             struct exception *ex)
{
  return validation(
      ask(&self->link, ex, "process_handshake", "th>t", message, handshake, answer));
}

static void erase(struct secret *secret)
{
  if (secret->value.secret != NULL)
    explicit_bzero(secret->value.secret, (size_t)secret->value.size);
  free(secret->value.secret);
  explicit_bzero(secret, sizeof *secret);
  free(secret);
}

static handle_t keep(struct plugin *self, struct secret *secret)
{
  pthread_mutex_lock(&self->mutex);
  secret->next = self->secrets;
  self->secrets = secret;
  pthread_mutex_unlock(&self->mutex);
  return (handle_t)(intptr_t)&secret->value; /* the crypto plugin reads it there */
}

static handle_t get_shared_secret(struct plugin *self, handle_t handshake, struct exception *ex)
{
  handle_t peer = 0;
  int64_t end;
  struct octets found = {0};
  struct secret *secret = calloc(1, sizeof *secret);
  if (secret == NULL) {
    refuse(ex, "pqsec: no memory for a shared secret");
    return 0;
  }
  int result = ask(&self->link, ex, "get_shared_secret", "h>hxcco", handshake, &peer, &end,
                   secret->value.challenge1, secret->value.challenge2, &found);
  secret->peer = peer;
  secret->value.secret = found.buffer;
  secret->value.size = (int32_t)found.length;
  if (result < 0) {
    erase(secret);
    return 0;
  }
  watch_add(&self->watch, peer, end);
  return keep(self, secret);
}

static uint8_t get_authenticated_peer_credential_token(struct plugin *self, struct token *token,
                                                       handle_t handshake, struct exception *ex)
{
  return ask(&self->link, ex, "get_authenticated_peer_credential_token", "h>t", handshake,
             token) >= 0;
}

static uint8_t set_listener(struct plugin *self, const struct listener *listener,
                            struct exception *ex)
{
  (void)ex;
  watch_tell(&self->watch, listener != NULL ? listener->on_revoke : NULL);
  return true;
}

/* Cyclone frees identity tokens itself. */
static uint8_t return_nothing(struct plugin *self, const void *token, struct exception *ex)
{
  (void)self, (void)token, (void)ex;
  return true;
}

static uint8_t return_token(struct plugin *self, struct token *token, struct exception *ex)
{
  (void)self, (void)ex;
  free_token(token);
  return true;
}

static uint8_t return_handshake_handle(struct plugin *self, handle_t handshake,
                                       struct exception *ex)
{
  return ask(&self->link, ex, "return_handshake_handle", "h>", handshake) >= 0;
}

static void erase_secrets(struct plugin *self, handle_t peer, bool all)
{
  pthread_mutex_lock(&self->mutex);
  for (struct secret **at = &self->secrets; *at != NULL;) {
    struct secret *found = *at;
    if (all || found->peer == peer) {
      *at = found->next;
      erase(found);
    } else {
      at = &found->next;
    }
  }
  pthread_mutex_unlock(&self->mutex);
}

/* This succeeds even if the agent has ended: its objects have ended with it. */
static uint8_t return_identity_handle(struct plugin *self, handle_t identity, struct exception *ex)
{
  (void)ex;
  watch_remove(&self->watch, identity);
  erase_secrets(self, identity, false);
  ask(&self->link, NULL, "return_identity_handle", "h>", identity);
  return true;
}

static uint8_t return_sharedsecret_handle(struct plugin *self, handle_t secret,
                                          struct exception *ex)
{
  (void)self, (void)secret, (void)ex;
  return true; /* erased with the peer's identity */
}

EXPORT int init_authentication(const char *argument, void **context, void *domain)
{
  (void)argument;
  struct plugin *self = *context = calloc(1, sizeof *self);
  if (self == NULL)
    return -1;
  self->functions = (struct authentication){
      .domain = domain,
      .validate_local_identity = (function)validate_local_identity,
      .get_identity_token = (function)get_identity_token,
      .get_identity_status_token = (function)get_identity_status_token,
      .set_permissions_credential_and_token = (function)set_permissions_credential_and_token,
      .validate_remote_identity = (function)validate_remote_identity,
      .begin_handshake_request = (function)begin_handshake_request,
      .begin_handshake_reply = (function)begin_handshake_reply,
      .process_handshake = (function)process_handshake,
      .get_shared_secret = (function)get_shared_secret,
      .get_authenticated_peer_credential_token = (function)get_authenticated_peer_credential_token,
      .set_listener = (function)set_listener,
      .return_identity_token = (function)return_nothing,
      .return_identity_status_token = (function)return_nothing,
      .return_authenticated_peer_credential_token = (function)return_token,
      .return_handshake_handle = (function)return_handshake_handle,
      .return_identity_handle = (function)return_identity_handle,
      .return_sharedsecret_handle = (function)return_sharedsecret_handle,
  };
  link_init(&self->link, "authentication");
  watch_init(&self->watch, self);
  pthread_mutex_init(&self->mutex, NULL);
  return 0;
}

EXPORT int finalize_authentication(void *context)
{
  struct plugin *self = context;
  watch_end(&self->watch);
  link_close(&self->link);
  erase_secrets(self, 0, true);
  free(self);
  return 0;
}
