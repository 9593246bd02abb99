// Calls each function of the adapter for Fast DDS 2.x, as the library does, with two participants in
// one process; for sanitizers and valgrind.
//
// usage: fastdds_every_function ENCLAVE ENCLAVE TOPIC agent|none|madTIMES
//
// With an agent all must be granted; without one (its folder cannot be trusted) all must be refused,
// and nothing be lost either way. With one that has gone mad anything may come of it, many times. It prints how many calls were made, and exits with 1 at the first
// that did not end so.

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>

#include <fastdds/rtps/builtin/data/ParticipantProxyData.h>
#include <fastdds/rtps/builtin/data/ReaderProxyData.h>
#include <fastdds/rtps/builtin/data/WriterProxyData.h>

#include "stack.hpp"

using namespace rtps;
using namespace rtps::security;

using Factory = void* (*)(void*, const PropertyPolicy*);
extern "C" void* pqsec_authentication(const PropertyPolicy*, Factory, void*) noexcept;
extern "C" void* pqsec_access_control(const PropertyPolicy*, Factory, void*) noexcept;
extern "C" void pqsec_discovery(const void*) noexcept;
extern "C" void pqsec_lost(const void*, void (*)(void*, const uint8_t*), void*) noexcept;
extern "C" bool pqsec_probe() noexcept;
extern "C" const char pqsec_build_id[];

namespace {

bool has_agent, is_mad;
int calls = 0;

// A call must be granted exactly if there is an agent.
void expect(const char* name, bool granted, const SecurityException& exception) {
  calls++;
  if (is_mad || (granted == has_agent && (granted || *exception.what() != '\0'))) return;
  fprintf(stderr, "%s: %s\n", name, exception.what());
  exit(1);
}

void must(const char* name, bool done) {
  calls++;
  if (is_mad || done) return;
  fprintf(stderr, "%s: not done\n", name);
  exit(1);
}

#define CALL(object, function, ...) \
  expect(#function, (object)->function(__VA_ARGS__, exception), exception)
#define IS_GOOD(object, function, result, ...) \
  expect(#function, (object)->function(__VA_ARGS__, exception) == (result), exception)

void* none(void*, const PropertyPolicy*) { return nullptr; }

struct Participant {
  explicit Participant(const std::string& folder, uint8_t first) {
    const std::string auth = "dds.sec.auth.builtin.PKI-DH.";
    const std::string access = "dds.sec.access.builtin.Access-Permissions.";
    const std::string uri = "file://" + folder + "/";
    auto& properties = attributes.properties.properties();
    properties.emplace_back("dds.sec.auth.plugin", "builtin.PKI-DH");
    properties.emplace_back("dds.sec.access.plugin", "builtin.Access-Permissions");
    properties.emplace_back("dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC");
    properties.emplace_back("dds.sec.log.plugin", "builtin.DDS_LogTopic");
    properties.emplace_back(auth + "identity_ca", uri + "identity_ca.cert.pem");
    properties.emplace_back(auth + "identity_certificate", uri + "cert.pem");
    properties.emplace_back(auth + "private_key", uri + "key.pem");
    properties.emplace_back(auth + "identity_crl", uri + "crl.pem");
    properties.emplace_back(access + "permissions_ca", uri + "permissions_ca.cert.pem");
    properties.emplace_back(access + "governance", uri + "governance.p7s");
    properties.emplace_back(access + "permissions", uri + "permissions.p7s");
    candidate.guidPrefix.value[0] = first;
    auto policy = &attributes.properties;
    authentication.reset(static_cast<Authentication*>(pqsec_authentication(policy, none, nullptr)));
    control.reset(static_cast<AccessControl*>(pqsec_access_control(policy, none, nullptr)));
  }

  void join() {
    IS_GOOD(authentication, validate_local_identity, VALIDATION_OK, &identity, guid, 0, attributes,
            candidate);
    if (identity == nullptr) identity = authentication->get_identity_handle(exception);
    permissions = control->validate_local_permissions(*authentication, *identity, 0, attributes,
                                                      exception);
    expect("validate_local_permissions", permissions != nullptr, exception);
    if (permissions == nullptr) permissions = control->get_permissions_handle(exception);
    must("set_listener", authentication->set_listener(nullptr, exception));
    CALL(control, check_create_participant, *permissions, 0, attributes);
    DataHolder* credential = nullptr;
    CALL(control, get_permissions_credential_token, &credential, *permissions);
    CALL(control, get_permissions_token, &permissions_token, *permissions);
    DataHolder nothing;
    CALL(authentication, set_permissions_credential_and_token, *identity,
         credential != nullptr ? *credential : nothing);
    must("return", control->return_permissions_credential_token(credential, exception));
    pqsec_discovery(this);  // as while Fast DDS describes the participant
    CALL(authentication, get_identity_token, &identity_token, *identity);
    pqsec_discovery(nullptr);
  }

  // How many peers must go.
  int lost() const {
    int count = 0;
    pqsec_lost(this, [](void* context, const uint8_t*) { ++*static_cast<int*>(context); }, &count);
    return count;
  }

  void create(const std::string& topic) {
    const std::vector<std::string> partitions = {"", "floor"};
    const std::vector<std::string> no_partitions;
    CALL(control, check_create_datawriter, *permissions, 0, topic, no_partitions);
    CALL(control, check_create_datareader, *permissions, 0, topic, no_partitions);
    ParticipantSecurityAttributes participant;
    CALL(control, get_participant_sec_attributes, *permissions, participant);
    EndpointSecurityAttributes endpoint;
    CALL(control, get_datawriter_sec_attributes, *permissions, topic, partitions, endpoint);
    CALL(control, get_datareader_sec_attributes, *permissions, topic, partitions, endpoint);
  }

  void hear_of(const Participant& other) {
    DataHolder token;
    if (other.identity_token != nullptr) token = *other.identity_token;
    const auto result =
        authentication->validate_remote_identity(&peer, *identity, token, other.guid, exception);
    expect("validate_remote_identity", result != VALIDATION_FAILED, exception);
    begins = result == VALIDATION_PENDING_HANDSHAKE_REQUEST;
    if (peer == nullptr) peer = authentication->get_identity_handle(exception);
    DataHolder stranger;
    IdentityHandle* unknown = nullptr;
    must("a stranger", authentication->validate_remote_identity(&unknown, *identity, stranger,
                                                                other.guid, exception) ==
                           VALIDATION_FAILED);
  }

  // What travels is a copy, as on the wire.
  DataHolder request() {
    IS_GOOD(authentication, begin_handshake_request, VALIDATION_PENDING_HANDSHAKE_MESSAGE,
            &handshake, &message, *identity, *peer, data());
    return message != nullptr ? *message : DataHolder();
  }

  DataHolder reply(DataHolder&& request) {
    IS_GOOD(authentication, begin_handshake_reply, VALIDATION_PENDING_HANDSHAKE_MESSAGE, &handshake,
            &message, std::move(request), *peer, *identity, data());
    return message != nullptr ? *message : DataHolder();
  }

  DataHolder process(DataHolder&& received, ValidationResult_t result) {
    IS_GOOD(authentication, process_handshake, result, &message, std::move(received), *handshake);
    return message != nullptr ? *message : DataHolder();
  }

  void agree(const Participant& other, const std::string& topic) {
    if (handshake != nullptr) {
      secret = authentication->get_shared_secret(*handshake, exception);
      expect("get_shared_secret", secret != nullptr, exception);
    }
    DataHolder* credential = nullptr;
    CALL(authentication, get_authenticated_peer_credential_token, &credential, *peer);
    DataHolder nothing;
    remote = control->validate_remote_permissions(
        *authentication, *identity, *permissions, *peer,
        other.permissions_token != nullptr ? *other.permissions_token : nothing,
        credential != nullptr ? *credential : nothing, exception);
    expect("validate_remote_permissions", remote != nullptr, exception);
    if (remote == nullptr) remote = control->get_permissions_handle(exception);
    must("return", authentication->return_authenticated_peer_credential_token(credential,
                                                                              exception));
    RTPSParticipantAllocationAttributes allocation;
    const ParticipantProxyData participant(allocation);
    CALL(control, check_remote_participant, *remote, 0, participant);
    WriterProxyData writer(4, 4);
    ReaderProxyData reader(4, 4);
    writer.topicName(topic);
    reader.topicName(topic);
    bool relay_only = true;
    CALL(control, check_remote_datawriter, *remote, 0, writer);
    CALL(control, check_remote_datareader, *remote, 0, reader, relay_only);
    must("relay_only", relay_only != has_agent || !has_agent);
  }

  void leave() {
    must("return", authentication->return_sharedsecret_handle(secret, exception));
    must("return", authentication->return_handshake_handle(handshake, exception));
    must("return", authentication->return_identity_token(identity_token, exception));
    must("return", control->return_permissions_token(permissions_token, exception));
    must("return", control->return_permissions_handle(remote, exception));
    must("return", control->return_permissions_handle(permissions, exception));
    must("return", authentication->return_identity_handle(peer, exception));
    must("return", authentication->return_identity_handle(identity, exception));
  }

  const CDRMessage_t& data() {
    static CDRMessage_t message(64);
    message.length = 24;  // octets; the participant's GUID stands in it
    memcpy(message.buffer, "\0\x50\0\x10", 4);
    memcpy(message.buffer + 4, guid.guidPrefix.value, 12);
    memcpy(message.buffer + 16, guid.entityId.value, 4);
    memcpy(message.buffer + 20, "\0\1\0\0", 4);
    return message;
  }

  RTPSParticipantAttributes attributes;
  GUID_t candidate, guid;
  std::unique_ptr<Authentication> authentication;
  std::unique_ptr<AccessControl> control;
  SecurityException exception;
  IdentityHandle *identity = nullptr, *peer = nullptr;
  PermissionsHandle *permissions = nullptr, *remote = nullptr;
  HandshakeHandle* handshake = nullptr;
  HandshakeMessageToken* message = nullptr;
  IdentityToken* identity_token = nullptr;
  PermissionsToken* permissions_token = nullptr;
  std::shared_ptr<SecretHandle> secret;
  bool begins = false;
};

}  // namespace

void everything(char** words) {
  const PropertyPolicy open_to_all;
  must("no security", pqsec_authentication(&open_to_all, none, nullptr) == nullptr);
  must("no security", pqsec_access_control(&open_to_all, none, nullptr) == nullptr);
  must("build ID", strlen(pqsec_build_id) > 0);
  must("probe", pqsec_probe());
  Participant one(words[1], 1), other(words[2], 2);
  one.join();
  other.join();
  one.create(words[3]);
  one.hear_of(other);
  other.hear_of(one);
  auto &first = one.begins ? one : other, &second = one.begins ? other : one;
  auto reply = second.reply(first.request());
  if (has_agent || (first.handshake != nullptr && second.handshake != nullptr)) {
    auto final = first.process(std::move(reply), VALIDATION_OK_WITH_FINAL_MESSAGE);
    second.process(std::move(final), VALIDATION_OK);
  }
  one.agree(other, words[3]);
  other.agree(one, words[3]);
  must("nobody is revoked", one.lost() == 0 && other.lost() == 0);
  one.leave();
  other.leave();
}

int main(int count, char** words) {
  if (count != 5) return 2;
  has_agent = strcmp(words[4], "agent") == 0;
  is_mad = strncmp(words[4], "mad", 3) == 0;
  const int times = is_mad ? atoi(words[4] + 3) : 1;
  for (int i = 0; i < times; i++) everything(words);
  printf("%d\n", calls);
}
