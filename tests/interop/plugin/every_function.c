/* Every function of both plugins, without Cyclone DDS: two participants meet, ask all there is to
 * ask, and go. Before that all of it without an agent: each call is refused with words.
 *
 * usage: every_function ENCLAVE ENCLAVE TOPIC
 *
 * Compiled with sanitizers, which find what is not freed. Says how many calls were made. */

#define _GNU_SOURCE
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wire.h"

int init_authentication(const char *, void **, void *);
int finalize_authentication(void *);
int init_access_control(const char *, void **, void *);
int finalize_access_control(void *);

enum { DOMAIN = 0, FILES = 6, PENDING_REQUEST = 3, PENDING_MESSAGE = 4, FINAL = 5 };
static const char *const PROPERTIES[FILES][2] = {
    {"dds.sec.auth.identity_ca", "identity_ca.cert.pem"},
    {"dds.sec.auth.identity_certificate", "cert.pem"},
    {"dds.sec.auth.private_key", "key.pem"},
    {"dds.sec.access.permissions_ca", "permissions_ca.cert.pem"},
    {"dds.sec.access.governance", "governance.p7s"},
    {"dds.sec.access.permissions", "permissions.p7s"},
};

struct side {
  struct authentication *auth;
  struct access_control *access;
  struct property properties[FILES];
  struct qos qos;
  handle_t identity, rights, peer, handshake, peers_rights;
  struct guid guid;
  struct token identity_token, permissions, credential, peers_credential;
};

static struct exception ex;
static int calls;
static bool alone = true; /* no agent: every call must fail, and say why */

static void expect(bool good, const char *function)
{
  calls++;
  if (alone ? good || ex.message == NULL || ex.code == 0 : !good) {
    fprintf(stderr, "%s: %s\n", function, ex.message != NULL ? ex.message : "no words");
    exit(1);
  }
  free(ex.message);
  ex = (struct exception){0};
}

/* A call of a function with a result and arguments of those types, by what is good. */
#define CALL(good, result, plugin, name, types, ...)                                               \
  do {                                                                                             \
    result given = ((result(*) types)(void (*)(void))(plugin)->name)(plugin, __VA_ARGS__, &ex);    \
    expect(good, #name);                                                                           \
  } while (0)
#define SELF(...) (void *, __VA_ARGS__, struct exception *)

/* A big-endian ParameterList of PID_PARTICIPANT_GUID and PID_SENTINEL. */
static struct octets *data_of(const struct side *one)
{
  static uint8_t octets[24] = {0, 0x50, 0, 16, [21] = 1};
  static struct octets data = {.length = sizeof octets, .buffer = octets};
  memcpy(octets + 4, one->guid.octets, 16);
  return &data;
}

static void prepare(struct side *one, const char *enclave)
{
  void *made;
  if (init_authentication("", &made, NULL) != 0)
    exit(2);
  one->auth = made;
  if (init_access_control("", &made, NULL) != 0)
    exit(2);
  one->access = made;
  for (int i = 0; i < FILES; i++) {
    one->properties[i].name = (char *)PROPERTIES[i][0];
    if (asprintf(&one->properties[i].value, "file:%s/%s", enclave, PROPERTIES[i][1]) < 0)
      exit(2);
  }
  one->qos.properties = (struct properties){FILES, FILES, one->properties};
}

static void join(struct side *one)
{
  struct guid candidate = {"candidate-guid-"};
  CALL(given == VALIDATION_OK, int, one->auth, validate_local_identity,
       SELF(handle_t *, struct guid *, int32_t, struct qos *, struct guid *), &one->identity,
       &one->guid, DOMAIN, &one->qos, &candidate);
  CALL(given != 0 && (one->rights = given), handle_t, one->access, validate_local_permissions,
       SELF(void *, handle_t, int32_t, struct qos *), one->auth, one->identity, DOMAIN, &one->qos);
}

static void introduce(struct side *one)
{
  CALL(given, uint8_t, one->auth, get_identity_token, SELF(struct token *, handle_t),
       &one->identity_token, one->identity);
  CALL(given, uint8_t, one->access, get_permissions_token, SELF(struct token *, handle_t),
       &one->permissions, one->rights);
  CALL(given, uint8_t, one->access, get_permissions_credential_token,
       SELF(struct token *, handle_t), &one->credential, one->rights);
  CALL(given, uint8_t, one->auth, set_permissions_credential_and_token,
       SELF(handle_t, struct token *, struct token *), one->identity, &one->credential,
       &one->permissions);
}

static void discover(struct side *one, struct side *other)
{
  struct token request = {0};
  CALL(given == PENDING_REQUEST || given == PENDING_MESSAGE, int, one->auth,
       validate_remote_identity,
       SELF(handle_t *, struct token *, struct token *, handle_t, struct token *, struct guid *),
       &one->peer, &request, NULL, one->identity, &other->identity_token, &other->guid);
  free_token(&request);
}

static void shake_hands(struct side *one, struct side *other)
{
  struct token request = {0}, reply = {0}, final = {0}, none = {0};
  CALL(given == PENDING_MESSAGE, int, one->auth, begin_handshake_request,
       SELF(handle_t *, struct token *, handle_t, handle_t, struct octets *), &one->handshake,
       &request, one->identity, one->peer, data_of(one));
  CALL(given == PENDING_MESSAGE, int, other->auth, begin_handshake_reply,
       SELF(handle_t *, struct token *, struct token *, handle_t, handle_t, struct octets *),
       &other->handshake, &reply, &request, other->peer, other->identity, data_of(other));
  CALL(given == FINAL, int, one->auth, process_handshake,
       SELF(struct token *, struct token *, handle_t), &final, &reply, one->handshake);
  CALL(given == VALIDATION_OK, int, other->auth, process_handshake,
       SELF(struct token *, struct token *, handle_t), &none, &final, other->handshake);
  free_token(&request), free_token(&reply), free_token(&final), free_token(&none);
}

static void admit(struct side *one, struct side *other)
{
  CALL(given != 0, handle_t, one->auth, get_shared_secret, SELF(handle_t), one->handshake);
  CALL(given, uint8_t, one->auth, get_authenticated_peer_credential_token,
       SELF(struct token *, handle_t), &one->peers_credential, one->handshake);
  CALL(given != 0 && (one->peers_rights = given), handle_t, one->access,
       validate_remote_permissions,
       SELF(void *, handle_t, handle_t, struct token *, struct token *), one->auth, one->identity,
       one->peer, &other->permissions, &one->peers_credential);
}

static void ask_all(struct side *one, char *topic)
{
  char *names[] = {topic};
  struct strings partition = {.length = 0, .buffer = names};
  struct tags tags = {0};
  struct publication publication = {.topic = topic};
  struct subscription subscription = {.topic = topic};
  struct topic found = {.name = topic};
  struct participant_attributes participant;
  struct topic_attributes of_topic;
  struct endpoint_attributes endpoint;
  uint8_t relay_only;
  CALL(given, uint8_t, one->access, check_create_participant,
       SELF(handle_t, int32_t, struct qos *), one->rights, DOMAIN, &one->qos);
  CALL(given, uint8_t, one->access, check_create_datawriter,
       SELF(handle_t, int32_t, char *, struct qos *, struct strings *, struct tags *), one->rights,
       DOMAIN, topic, &one->qos, &partition, &tags);
  CALL(given, uint8_t, one->access, check_create_datareader,
       SELF(handle_t, int32_t, char *, struct qos *, struct strings *, struct tags *), one->rights,
       DOMAIN, topic, &one->qos, &partition, &tags);
  CALL(given, uint8_t, one->access, check_create_topic,
       SELF(handle_t, int32_t, char *, struct qos *), one->rights, DOMAIN, topic, &one->qos);
  CALL(given, uint8_t, one->access, check_remote_participant, SELF(handle_t, int32_t, void *),
       one->peers_rights, DOMAIN, NULL);
  CALL(given, uint8_t, one->access, check_remote_datawriter, SELF(handle_t, int32_t, void *),
       one->peers_rights, DOMAIN, &publication);
  CALL(given, uint8_t, one->access, check_remote_datareader,
       SELF(handle_t, int32_t, void *, uint8_t *), one->peers_rights, DOMAIN, &subscription,
       &relay_only);
  CALL(given, uint8_t, one->access, check_remote_topic, SELF(handle_t, int32_t, void *),
       one->peers_rights, DOMAIN, &found);
  CALL(given, uint8_t, one->access, get_participant_sec_attributes, SELF(handle_t, void *),
       one->rights, &participant);
  CALL(given, uint8_t, one->access, get_topic_sec_attributes, SELF(handle_t, char *, void *),
       one->rights, topic, &of_topic);
  CALL(given, uint8_t, one->access, get_datawriter_sec_attributes,
       SELF(handle_t, char *, struct strings *, struct tags *, void *), one->rights, topic,
       &partition, &tags, &endpoint);
  CALL(given, uint8_t, one->access, get_datareader_sec_attributes,
       SELF(handle_t, char *, struct strings *, struct tags *, void *), one->rights, topic,
       &partition, &tags, &endpoint);
}

static uint8_t revoked_nobody(const void *plugin, handle_t handle) { return plugin && handle; }

/* What the library answers without the agent, and what it does with or without one. */
static void leave(struct side *one)
{
  struct listener listener = {revoked_nobody};
  struct token status = {0};
  function *matches[] = {&one->access->check_local_datawriter_match,
                         &one->access->check_local_datareader_match,
                         &one->access->check_local_datawriter_register_instance,
                         &one->access->check_local_datawriter_dispose_instance,
                         &one->access->check_remote_datawriter_register_instance,
                         &one->access->check_remote_datawriter_dispose_instance,
                         &one->access->return_participant_sec_attributes,
                         &one->access->return_topic_sec_attributes,
                         &one->access->return_datawriter_sec_attributes,
                         &one->access->return_datareader_sec_attributes};
  for (size_t i = 0; i < sizeof matches / sizeof *matches; i++)
    expect(((uint8_t(*)(void *, void *, void *))*matches[i])(one->access, NULL, &ex), "allow");
  CALL(given, uint8_t, one->auth, set_listener, SELF(struct listener *), &listener);
  CALL(given, uint8_t, one->access, set_listener, SELF(struct listener *), &listener);
  CALL(given, uint8_t, one->auth, get_identity_status_token, SELF(struct token *, handle_t),
       &status, one->identity);
  CALL(given, uint8_t, one->auth, return_identity_status_token, SELF(struct token *), &status);
  CALL(given, uint8_t, one->auth, return_identity_token, SELF(struct token *),
       &one->identity_token);
  free_token(&one->identity_token); /* which Cyclone does itself */
  CALL(given, uint8_t, one->access, return_permissions_token, SELF(struct token *),
       &one->permissions);
  CALL(given, uint8_t, one->access, return_permissions_credential_token, SELF(struct token *),
       &one->credential);
  CALL(given, uint8_t, one->auth, return_authenticated_peer_credential_token,
       SELF(struct token *), &one->peers_credential);
  CALL(given, uint8_t, one->auth, return_sharedsecret_handle, SELF(handle_t), 1);
  CALL(given, uint8_t, one->access, return_permissions_handle, SELF(handle_t),
       one->peers_rights);
  CALL(given, uint8_t, one->access, return_permissions_handle, SELF(handle_t), one->rights);
  CALL(given, uint8_t, one->auth, return_identity_handle, SELF(handle_t), one->peer);
  CALL(given, uint8_t, one->auth, return_identity_handle, SELF(handle_t), one->identity);
  CALL(given, uint8_t, one->auth, set_listener, SELF(struct listener *), NULL);
  CALL(given, uint8_t, one->access, set_listener, SELF(struct listener *), NULL);
}

static void end(struct side *one)
{
  finalize_authentication(one->auth);
  finalize_access_control(one->access);
  for (int i = 0; i < FILES; i++)
    free(one->properties[i].value);
}

int main(int count, char **words)
{
  if (count != 4)
    return 2;
  struct side sides[2] = {{0}}, *first = &sides[0], *second = &sides[1];
  prepare(first, words[1]), prepare(second, words[2]);
  introduce(first), discover(first, second), shake_hands(first, second), admit(first, second);
  ask_all(first, words[3]); /* nobody has joined, so nobody has asked for the agent */
  alone = false;
  leave(first);
  join(first), join(second);
  introduce(first), introduce(second);
  if (memcmp(&first->guid, &second->guid, sizeof first->guid) > 0)
    first = &sides[1], second = &sides[0];
  discover(first, second), discover(second, first);
  shake_hands(first, second);
  admit(first, second), admit(second, first);
  ask_all(first, words[3]), ask_all(second, words[3]);
  CALL(given, uint8_t, first->auth, return_handshake_handle, SELF(handle_t), first->handshake);
  leave(first), leave(second);
  end(first), end(second);
  printf("%d\n", calls);
  return 0;
}
