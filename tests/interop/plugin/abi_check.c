/* Our declarations of Cyclone DDS's plugin interface against its installed headers: this compiles
 * if sizes, offsets and the order of functions are the same. The shared secret is in none of them:
 * the crypto plugin reads it in other tests. */

#include <stddef.h>

#include <dds/security/dds_security_api_access_control.h>
#include <dds/security/dds_security_api_authentication.h>

#include "abi.h"

#define SIZE(ours, theirs) _Static_assert(sizeof(ours) == sizeof(theirs), #theirs)
#define PLACE(ours, our, theirs, their)                                          \
  _Static_assert(offsetof(ours, our) == offsetof(theirs, their), #theirs "." #their)

SIZE(struct exception, DDS_Security_SecurityException);
PLACE(struct exception, code, DDS_Security_SecurityException, code);
PLACE(struct exception, minor_code, DDS_Security_SecurityException, minor_code);
SIZE(struct guid, DDS_Security_GUID_t);
SIZE(struct octets, DDS_Security_OctetSeq);
PLACE(struct octets, length, DDS_Security_OctetSeq, _length);
PLACE(struct octets, buffer, DDS_Security_OctetSeq, _buffer);
SIZE(struct strings, DDS_Security_StringSeq);
PLACE(struct strings, length, DDS_Security_StringSeq, _length);
PLACE(struct strings, buffer, DDS_Security_StringSeq, _buffer);
SIZE(struct property, DDS_Security_Property_t);
PLACE(struct property, value, DDS_Security_Property_t, value);
PLACE(struct property, propagate, DDS_Security_Property_t, propagate);
SIZE(struct binary_property, DDS_Security_BinaryProperty_t);
PLACE(struct binary_property, value, DDS_Security_BinaryProperty_t, value);
PLACE(struct binary_property, propagate, DDS_Security_BinaryProperty_t, propagate);
SIZE(struct properties, DDS_Security_PropertySeq);
SIZE(struct binary_properties, DDS_Security_BinaryPropertySeq);
SIZE(struct token, DDS_Security_DataHolder);
PLACE(struct token, properties, DDS_Security_DataHolder, properties);
PLACE(struct token, binary, DDS_Security_DataHolder, binary_properties);
SIZE(struct tag, DDS_Security_Tag);
SIZE(struct tags, DDS_Security_DataTags);
SIZE(struct qos, DDS_Security_Qos);
PLACE(struct qos, properties, DDS_Security_Qos, property.value);
SIZE(struct strings, DDS_Security_PartitionQosPolicy);

SIZE(struct participant_attributes, DDS_Security_ParticipantSecurityAttributes);
PLACE(struct participant_attributes, unauthenticated, DDS_Security_ParticipantSecurityAttributes,
      allow_unauthenticated_participants);
PLACE(struct participant_attributes, access, DDS_Security_ParticipantSecurityAttributes,
      is_access_protected);
PLACE(struct participant_attributes, rtps, DDS_Security_ParticipantSecurityAttributes,
      is_rtps_protected);
PLACE(struct participant_attributes, discovery, DDS_Security_ParticipantSecurityAttributes,
      is_discovery_protected);
PLACE(struct participant_attributes, liveliness, DDS_Security_ParticipantSecurityAttributes,
      is_liveliness_protected);
PLACE(struct participant_attributes, plugin, DDS_Security_ParticipantSecurityAttributes,
      plugin_participant_attributes);
SIZE(struct topic_attributes, DDS_Security_TopicSecurityAttributes);
PLACE(struct topic_attributes, write, DDS_Security_TopicSecurityAttributes, is_write_protected);
PLACE(struct topic_attributes, discovery, DDS_Security_TopicSecurityAttributes,
      is_discovery_protected);
PLACE(struct topic_attributes, liveliness, DDS_Security_TopicSecurityAttributes,
      is_liveliness_protected);
SIZE(struct endpoint_attributes, DDS_Security_EndpointSecurityAttributes);
PLACE(struct endpoint_attributes, write, DDS_Security_EndpointSecurityAttributes,
      is_write_protected);
PLACE(struct endpoint_attributes, discovery, DDS_Security_EndpointSecurityAttributes,
      is_discovery_protected);
PLACE(struct endpoint_attributes, liveliness, DDS_Security_EndpointSecurityAttributes,
      is_liveliness_protected);
PLACE(struct endpoint_attributes, submessage, DDS_Security_EndpointSecurityAttributes,
      is_submessage_protected);
PLACE(struct endpoint_attributes, payload, DDS_Security_EndpointSecurityAttributes,
      is_payload_protected);
PLACE(struct endpoint_attributes, key, DDS_Security_EndpointSecurityAttributes, is_key_protected);
PLACE(struct endpoint_attributes, plugin, DDS_Security_EndpointSecurityAttributes,
      plugin_endpoint_attributes);

SIZE(struct publication, DDS_Security_PublicationBuiltinTopicDataSecure);
PLACE(struct publication, topic, DDS_Security_PublicationBuiltinTopicDataSecure, topic_name);
PLACE(struct publication, partition, DDS_Security_PublicationBuiltinTopicDataSecure, partition);
PLACE(struct publication, tags, DDS_Security_PublicationBuiltinTopicDataSecure, data_tags);
SIZE(struct subscription, DDS_Security_SubscriptionBuiltinTopicDataSecure);
PLACE(struct subscription, topic, DDS_Security_SubscriptionBuiltinTopicDataSecure, topic_name);
PLACE(struct subscription, partition, DDS_Security_SubscriptionBuiltinTopicDataSecure, partition);
PLACE(struct subscription, tags, DDS_Security_SubscriptionBuiltinTopicDataSecure, data_tags);
PLACE(struct topic, name, DDS_Security_TopicBuiltinTopicData, name);

_Static_assert(VALIDATION_OK == DDS_SECURITY_VALIDATION_OK, "ok");
_Static_assert(VALIDATION_FAILED == DDS_SECURITY_VALIDATION_FAILED, "failed");
_Static_assert(VALIDATION_LAST == DDS_SECURITY_VALIDATION_OK_FINAL_MESSAGE, "last");

SIZE(struct listener, dds_security_access_control_listener);
PLACE(struct listener, on_revoke, dds_security_authentication_listener, on_revoke_identity);
PLACE(struct listener, on_revoke, dds_security_access_control_listener, on_revoke_permissions);

#define AUTHENTICATION(name) \
  PLACE(struct authentication, name, struct dds_security_authentication, name)
SIZE(struct authentication, struct dds_security_authentication);
PLACE(struct authentication, domain, struct dds_security_authentication, gv);
AUTHENTICATION(validate_local_identity);
AUTHENTICATION(get_identity_token);
AUTHENTICATION(get_identity_status_token);
AUTHENTICATION(set_permissions_credential_and_token);
AUTHENTICATION(validate_remote_identity);
AUTHENTICATION(begin_handshake_request);
AUTHENTICATION(begin_handshake_reply);
AUTHENTICATION(process_handshake);
AUTHENTICATION(get_shared_secret);
AUTHENTICATION(get_authenticated_peer_credential_token);
AUTHENTICATION(set_listener);
AUTHENTICATION(return_identity_token);
AUTHENTICATION(return_identity_status_token);
AUTHENTICATION(return_authenticated_peer_credential_token);
AUTHENTICATION(return_handshake_handle);
AUTHENTICATION(return_identity_handle);
AUTHENTICATION(return_sharedsecret_handle);

#define ACCESS_CONTROL(name) \
  PLACE(struct access_control, name, struct dds_security_access_control, name)
SIZE(struct access_control, struct dds_security_access_control);
PLACE(struct access_control, domain, struct dds_security_access_control, gv);
ACCESS_CONTROL(validate_local_permissions);
ACCESS_CONTROL(validate_remote_permissions);
ACCESS_CONTROL(check_create_participant);
ACCESS_CONTROL(check_create_datawriter);
ACCESS_CONTROL(check_create_datareader);
ACCESS_CONTROL(check_create_topic);
ACCESS_CONTROL(check_local_datawriter_register_instance);
ACCESS_CONTROL(check_local_datawriter_dispose_instance);
ACCESS_CONTROL(check_remote_participant);
ACCESS_CONTROL(check_remote_datawriter);
ACCESS_CONTROL(check_remote_datareader);
ACCESS_CONTROL(check_remote_topic);
ACCESS_CONTROL(check_local_datawriter_match);
ACCESS_CONTROL(check_local_datareader_match);
ACCESS_CONTROL(check_remote_datawriter_register_instance);
ACCESS_CONTROL(check_remote_datawriter_dispose_instance);
ACCESS_CONTROL(get_permissions_token);
ACCESS_CONTROL(get_permissions_credential_token);
ACCESS_CONTROL(set_listener);
ACCESS_CONTROL(return_permissions_token);
ACCESS_CONTROL(return_permissions_credential_token);
ACCESS_CONTROL(get_participant_sec_attributes);
ACCESS_CONTROL(get_topic_sec_attributes);
ACCESS_CONTROL(get_datawriter_sec_attributes);
ACCESS_CONTROL(get_datareader_sec_attributes);
ACCESS_CONTROL(return_participant_sec_attributes);
ACCESS_CONTROL(return_topic_sec_attributes);
ACCESS_CONTROL(return_datawriter_sec_attributes);
ACCESS_CONTROL(return_datareader_sec_attributes);
ACCESS_CONTROL(return_permissions_handle);
