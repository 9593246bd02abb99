// The access control plugin of Fast DDS: DDS-Security 1.1, 8.4.2.9. The agent answers. It is called
// at discovery, never for a sample.

#include "sessions.hpp"

namespace PQSEC_RTPS::security {

#pragma GCC visibility push(hidden)

using pqsec::guarded;
using pqsec::Lent;
using pqsec::List;
using pqsec::number_of;

// In the stack's own name space, so that its tables of virtual functions compare by names.
class PqsecAccessControl : public AccessControl {
 public:
  Handle* validate_local_permissions(Authentication&, const Handle& identity, const uint32_t domain,
                                     const Configuration& from,
                                     SecurityException& exception) override {
    return guarded<Handle*>(exception, nullptr, [&]() -> Handle* {
      if (!link_.open(exception)) return nullptr;
      const pqsec::Settings settings(policy_of(from));
      const auto folder = pqsec::working_folder();
      pqsec::handle_t number = 0;
      int64_t end;
      const int result = link_.ask(exception, "validate_local_permissions", "hnsq>hx",
                                   number_of(identity), static_cast<int32_t>(domain),
                                   folder.c_str(), settings.get(), &number, &end);
      if (result >= 0) return new pqsec::Numbered(number);
      fprintf(stderr, "%s\n", exception.what());  // the stack does not log it
      return nullptr;
    });
  }

  bool get_permissions_token(DataHolder** token, const Handle& permissions,
                             SecurityException& exception) override {
    return guarded(exception, false, [&] {
      return link_.give(token, [&](agent::token* into) {
        return link_.ask(exception, "get_permissions_token", "h>t", number_of(permissions), into);
      });
    });
  }

  bool return_permissions_token(DataHolder* token, SecurityException&) override {
    return pqsec::drop(token);
  }

  bool get_permissions_credential_token(DataHolder** token, const Handle& permissions,
                                        SecurityException& exception) override {
    return guarded(exception, false, [&] {
      return link_.give(token, [&](agent::token* into) {
        return link_.ask(exception, "get_permissions_credential_token", "h>t",
                         number_of(permissions), into);
      });
    });
  }

  bool return_permissions_credential_token(DataHolder* token, SecurityException&) override {
    return pqsec::drop(token);
  }

  // For a peer that is not known yet.
  Handle* get_permissions_handle(SecurityException& exception) override {
    return guarded<Handle*>(exception, nullptr, [] { return new pqsec::Numbered(0); });
  }

  // This succeeds even if the agent has ended.
  bool return_permissions_handle(Handle* handle, SecurityException& exception) override {
    const std::unique_ptr<pqsec::Numbered> permissions(static_cast<pqsec::Numbered*>(handle));
    if (permissions && permissions->number != 0)
      link_.ask(exception, "return_permissions_handle", "h>", permissions->number);
    return true;
  }

  Handle* validate_remote_permissions(Authentication&, const Handle& identity, const Handle&,
                                      const Handle& peer, const DataHolder& token,
                                      const DataHolder& credential,
                                      SecurityException& exception) override {
    return guarded<Handle*>(exception, nullptr, [&]() -> Handle* {
      pqsec::handle_t number = 0;
      int64_t end;
      const int result = link_.ask(exception, "validate_remote_permissions", "hhtt>hx",
                                   number_of(identity), number_of(peer), Lent(token).get(),
                                   Lent(credential).get(), &number, &end);
      if (result < 0) return nullptr;
      static_cast<const pqsec::Identity&>(peer).lasts_until(end);
      return new pqsec::Numbered(number);
    });
  }

#if PQSEC_BY_PROPERTIES
  bool check_create_participant(const Handle& permissions, const uint32_t domain,
                                SecurityException& exception) override {
#else
  bool check_create_participant(const Handle& permissions, const uint32_t domain,
                                const Configuration&, SecurityException& exception) override {
#endif
    return link_.ask(exception, "check_create_participant", "hn>", number_of(permissions),
                     static_cast<int32_t>(domain)) >= 0;
  }

  bool check_remote_participant(const Handle& permissions, const uint32_t domain,
                                const ParticipantProxyData&,
                                SecurityException& exception) override {
    return link_.ask(exception, "check_remote_participant", "hn>", number_of(permissions),
                     static_cast<int32_t>(domain)) >= 0;
  }

  bool check_create_datawriter(const Handle& permissions, const uint32_t domain,
                               const std::string& topic, const Strings& partitions,
                               SecurityException& exception) override {
    return guarded(exception, false, [&] {
      return link_.ask(exception, "check_create_datawriter", "hnspd>", number_of(permissions),
                       static_cast<int32_t>(domain), topic.c_str(), List(partitions).get(),
                       NO_TAGS) >= 0;
    });
  }

  bool check_create_datareader(const Handle& permissions, const uint32_t domain,
                               const std::string& topic, const Strings& partitions,
                               SecurityException& exception) override {
    return guarded(exception, false, [&] {
      return link_.ask(exception, "check_create_datareader", "hnspd>", number_of(permissions),
                       static_cast<int32_t>(domain), topic.c_str(), List(partitions).get(),
                       NO_TAGS) >= 0;
    });
  }

  bool check_remote_datawriter(const Handle& permissions, const uint32_t domain,
                               const WriterProxyData& data, SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const Discovered found(data);
      return link_.ask(exception, "check_remote_datawriter", "hnspd>", number_of(permissions),
                       static_cast<int32_t>(domain), found.topic.c_str(),
                       List(found.partitions).get(), NO_TAGS) >= 0;
    });
  }

  bool check_remote_datareader(const Handle& permissions, const uint32_t domain,
                               const ReaderProxyData& data, bool& relay_only,
                               SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const Discovered found(data);
      uint8_t relay = 0;
      const int result = link_.ask(exception, "check_remote_datareader", "hnspd>b",
                                   number_of(permissions), static_cast<int32_t>(domain),
                                   found.topic.c_str(), List(found.partitions).get(), NO_TAGS,
                                   &relay);
      relay_only = relay != 0;
      return result >= 0;
    });
  }

  bool get_participant_sec_attributes(const Handle& permissions, ParticipantSecurityAttributes& to,
                                      SecurityException& exception) override {
    uint8_t unauthenticated, access, whole, discovery, liveliness;
    uint32_t mask;
    if (link_.ask(exception, "get_participant_sec_attributes", "h>bbbbbm", number_of(permissions),
                  &unauthenticated, &access, &whole, &discovery, &liveliness, &mask) < 0)
      return false;
    to.allow_unauthenticated_participants = unauthenticated != 0;
    to.is_access_protected = access != 0;
    to.is_rtps_protected = whole != 0;
    to.is_discovery_protected = discovery != 0;
    to.is_liveliness_protected = liveliness != 0;
    to.plugin_participant_attributes = mask;
    return true;
  }

  bool get_datawriter_sec_attributes(const Handle& permissions, const std::string& topic,
                                     const Strings&, EndpointSecurityAttributes& to,
                                     SecurityException& exception) override {
    return attributes(permissions, topic, to, exception);
  }

  bool get_datareader_sec_attributes(const Handle& permissions, const std::string& topic,
                                     const Strings&, EndpointSecurityAttributes& to,
                                     SecurityException& exception) override {
    return attributes(permissions, topic, to, exception);
  }

 private:
  static constexpr const agent::tags* NO_TAGS = nullptr;  // Fast DDS has no data tags

  // Governance has rules for topics only, the same for writers and readers.
  bool attributes(const Handle& permissions, const std::string& topic,
                  EndpointSecurityAttributes& to, SecurityException& exception) const {
    uint8_t read, write, discovery, liveliness, submessage, payload, key;
    uint32_t mask;
    if (link_.ask(exception, "get_endpoint_sec_attributes", "hs>bbbbbbbm", number_of(permissions),
                  topic.c_str(), &read, &write, &discovery, &liveliness, &submessage, &payload,
                  &key, &mask) < 0)
      return false;
    to.is_read_protected = read != 0;
    to.is_write_protected = write != 0;
    to.is_discovery_protected = discovery != 0;
    to.is_liveliness_protected = liveliness != 0;
    to.is_submessage_protected = submessage != 0;
    to.is_payload_protected = payload != 0;
    to.is_key_protected = key != 0;
    to.plugin_endpoint_attributes = mask;
    return true;
  }

  pqsec::Link link_{"access_control"};
};

#pragma GCC visibility pop

}  // namespace PQSEC_RTPS::security

using Factory = void* (*)(void* self, const rtps::PropertyPolicy* policy);

// As pqsec_authentication, in authentication.cpp.
PQSEC_EXPORT void* pqsec_access_control(const rtps::PropertyPolicy* policy, Factory original,
                                        void* self) noexcept {
  using namespace rtps::security;
  if (!pqsec::is_secured(*policy)) return original(self, policy);
  return static_cast<AccessControl*>(new PqsecAccessControl);
}
