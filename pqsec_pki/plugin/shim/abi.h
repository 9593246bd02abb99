/* Cyclone DDS's plugin interface, as far as the shim reads or writes it: the layouts of
 * dds_security_api_{types,authentication,access_control}.h, 0.10.2 to 11.0.1 alike.
 * tests/interop/abi_check.c compares all of it with the installed headers. */

#ifndef PQSEC_ABI_H
#define PQSEC_ABI_H

#include <stdint.h>

typedef int64_t handle_t; /* identity, handshake, permissions, shared secret; 0 is none */

enum validation { VALIDATION_OK, VALIDATION_FAILED, VALIDATION_LAST = 5 };

enum { ERROR_CODE = 200 }; /* DDS_SECURITY_ERR_UNDEFINED_CODE */

struct exception { char *message; int32_t code, minor_code; };

struct guid { uint8_t octets[16]; };

struct octets { uint32_t maximum, length; uint8_t *buffer; };

struct strings { uint32_t maximum, length; char **buffer; };

struct property { char *name, *value; uint8_t propagate; };

struct properties { uint32_t maximum, length; struct property *buffer; };

struct binary_property { char *name; struct octets value; uint8_t propagate; };

struct binary_properties { uint32_t maximum, length; struct binary_property *buffer; };

struct token { char *class_id; struct properties properties; struct binary_properties binary; };

struct tag { char *name, *value; };

struct tags { uint32_t maximum, length; struct tag *buffer; };

struct qos { struct properties properties; struct binary_properties binary; struct tags tags; };

struct participant_attributes {
  uint8_t unauthenticated, access, rtps, discovery, liveliness;
  uint32_t plugin;
  struct properties endpoint_properties;
};

struct topic_attributes { uint8_t read, write, discovery, liveliness; };

struct endpoint_attributes {
  uint8_t read, write, discovery, liveliness, submessage, payload, key;
  uint32_t plugin;
  struct properties endpoint_properties;
};

/* What discovery says of an endpoint. Only the named members are read. */
struct duration { int32_t seconds; uint32_t nanoseconds; };

struct publication {
  uint32_t key[3], participant[3];
  char *topic, *type;
  uint32_t durability;
  struct duration deadline, latency;
  struct { uint32_t kind; struct duration lease; } liveliness;
  struct { uint32_t kind; struct duration blocking; uint8_t synchronous; } reliability;
  struct duration lifespan;
  uint32_t destination_order;
  struct octets user_data;
  uint32_t ownership;
  int32_t strength;
  struct { uint32_t scope; uint8_t coherent, ordered; } presentation;
  struct strings partition;
  struct octets topic_data, group_data;
  uint32_t security[2];
  struct tags tags;
};

struct subscription {
  uint32_t key[3], participant[3];
  char *topic, *type;
  uint32_t durability;
  struct duration deadline, latency;
  struct { uint32_t kind; struct duration lease; } liveliness;
  struct { uint32_t kind; struct duration blocking; uint8_t synchronous; } reliability;
  uint32_t ownership, destination_order;
  struct octets user_data;
  struct duration time_based_filter;
  struct { uint32_t scope; uint8_t coherent, ordered; } presentation;
  struct strings partition;
  struct octets topic_data, group_data;
  uint32_t security[2];
  struct tags tags;
};

struct topic { uint32_t key[3]; char *name, *type; }; /* and policies, which are not read */

struct shared_secret { uint8_t *secret; int32_t size; uint8_t challenge1[32], challenge2[32]; };

/* The tables of functions. Each function has its own type in Cyclone; only the order counts here. */
typedef void (*function)(void);

struct authentication {
  void *domain;
  function validate_local_identity, get_identity_token, get_identity_status_token,
      set_permissions_credential_and_token, validate_remote_identity, begin_handshake_request,
      begin_handshake_reply, process_handshake, get_shared_secret,
      get_authenticated_peer_credential_token, set_listener, return_identity_token,
      return_identity_status_token, return_authenticated_peer_credential_token,
      return_handshake_handle, return_identity_handle, return_sharedsecret_handle;
};

struct access_control {
  void *domain;
  function validate_local_permissions, validate_remote_permissions, check_create_participant,
      check_create_datawriter, check_create_datareader, check_create_topic,
      check_local_datawriter_register_instance, check_local_datawriter_dispose_instance,
      check_remote_participant, check_remote_datawriter, check_remote_datareader,
      check_remote_topic, check_local_datawriter_match, check_local_datareader_match,
      check_remote_datawriter_register_instance, check_remote_datawriter_dispose_instance,
      get_permissions_token, get_permissions_credential_token, set_listener,
      return_permissions_token, return_permissions_credential_token,
      get_participant_sec_attributes, get_topic_sec_attributes, get_datawriter_sec_attributes,
      get_datareader_sec_attributes, return_participant_sec_attributes,
      return_topic_sec_attributes, return_datawriter_sec_attributes,
      return_datareader_sec_attributes, return_permissions_handle;
};

/* Both listeners: the first member is called when a handle is no longer valid. */
typedef uint8_t (*revoked)(const void *plugin, handle_t handle);

struct listener { revoked on_revoke; };

#endif
