// The authentication plugin of Fast DDS: DDS-Security 1.1, 8.3.2.7. The agent answers.

#include "sessions.hpp"

namespace PQSEC_RTPS::security {

#pragma GCC visibility push(hidden)

struct PqsecHandshake : pqsec::Numbered {
  using Numbered::Numbered;
  DataHolder message;  // the stack reads it there until the next one, and does not delete it
};

struct PqsecSecret : SharedSecretHandle {
  ~PqsecSecret() override {
    for (auto& each : (*this)->data_) explicit_bzero(each.value().data(), each.value().size());
  }
};

// A secret as the agent gives it.
struct Erased {
  Erased() = default;
  ~Erased() {
    if (octets.buffer != nullptr) explicit_bzero(octets.buffer, octets.length);
    free(octets.buffer);
  }
  Erased(const Erased&) = delete;
  Erased& operator=(const Erased&) = delete;
  std::vector<uint8_t> value() const { return {octets.buffer, octets.buffer + octets.length}; }
  agent::octets octets{};
};

enum { CHALLENGE = 32 };  // octets

using pqsec::guarded;
using pqsec::Lent;
using pqsec::number_of;

// In the stack's own name space, so that its tables of virtual functions compare by names.
class PqsecAuthentication : public Authentication {
 public:
  ValidationResult_t validate_local_identity(Handle** identity, GUID_t& adjusted,
                                             const uint32_t domain, const Configuration& from,
                                             const GUID_t& candidate,
                                             SecurityException& exception) override {
    return guarded(exception, VALIDATION_FAILED, [&] {
      const auto wrong = pqsec::wrong_plugin(policy_of(from));
      if (!wrong.empty()) {
        pqsec::tell_user(exception, wrong.c_str());
        return VALIDATION_FAILED;
      }
      if (!link_.open(exception)) return VALIDATION_FAILED;
      const pqsec::Settings settings(policy_of(from));
      const auto folder = pqsec::working_folder();
      const auto before = pqsec::octets_of(candidate);
      agent::guid after;
      pqsec::handle_t number = 0;
      int64_t end;
      uint8_t has_list;
      const int result = link_.ask(exception, "validate_local_identity", "nsqg>hgxb",
                                   static_cast<int32_t>(domain), folder.c_str(), settings.get(),
                                   &before, &number, &after, &end, &has_list);
      if (result != VALIDATION_OK) {
        fprintf(stderr, "%s\n", exception.what());  // the stack does not log it
        return VALIDATION_FAILED;
      }
      if (has_list != 0) sessions_.has_list();
      *identity = new pqsec::Identity(number, after);
      adjusted = pqsec::guid_of(after);
      return VALIDATION_OK;
    });
  }

  ValidationResult_t validate_remote_identity(Handle** peer, const Handle& identity,
                                              const DataHolder& token, const GUID_t& guid,
                                              SecurityException& exception) override {
    return guarded(exception, VALIDATION_FAILED, [&] {
      if (token.class_id().empty()) {
        pqsec::tell(exception, "pqsec: a participant without an identity token is refused");
        return VALIDATION_FAILED;
      }
      const auto octets = pqsec::octets_of(guid);
      const agent::token* no_request = nullptr;
      pqsec::Given request;  // Fast DDS has no way to send it
      pqsec::handle_t number = 0;
      const int result =
          link_.ask(exception, "validate_remote_identity", "thtg>ht", no_request,
                    number_of(identity), Lent(token).get(), &octets, &number, request.get());
      if (result < 0) return VALIDATION_FAILED;
      auto made = std::make_unique<pqsec::Identity>(number, octets);
      sessions_.add(made.get());
      *peer = made.release();
      return validation(result);
    });
  }

  ValidationResult_t begin_handshake_request(Handle** handshake, DataHolder** message,
                                             const Handle& identity, Handle& peer,
                                             const CDRMessage_t& data,
                                             SecurityException& exception) override {
    return guarded(exception, VALIDATION_FAILED, [&] {
      const agent::octets octets = {data.length, data.length, data.buffer};
      pqsec::Given token;
      pqsec::handle_t number = 0;
      const int result =
          link_.ask(exception, "begin_handshake_request", "hho>ht", number_of(identity),
                    number_of(peer), &octets, &number, token.get());
      return begun(result, number, token, peer, handshake, message);
    });
  }

  ValidationResult_t begin_handshake_reply(Handle** handshake, DataHolder** message,
                                           DataHolder&& request, Handle& peer,
                                           const Handle& identity, const CDRMessage_t& data,
                                           SecurityException& exception) override {
    return guarded(exception, VALIDATION_FAILED, [&] {
      const agent::octets octets = {data.length, data.length, data.buffer};
      pqsec::Given token;
      pqsec::handle_t number = 0;
      const int result =
          link_.ask(exception, "begin_handshake_reply", "thho>ht", Lent(request).get(),
                    number_of(peer), number_of(identity), &octets, &number, token.get());
      return begun(result, number, token, peer, handshake, message);
    });
  }

  ValidationResult_t process_handshake(DataHolder** message, DataHolder&& received, Handle& handle,
                                       SecurityException& exception) override {
    return guarded(exception, VALIDATION_FAILED, [&] {
      auto& handshake = static_cast<PqsecHandshake&>(handle);
      pqsec::Given token;
      const int result = link_.ask(exception, "process_handshake", "th>t", Lent(received).get(),
                                   handshake.number, token.get());
      if (result == VALIDATION_OK_WITH_FINAL_MESSAGE) {
        handshake.message = token.holder();
        *message = &handshake.message;
      }
      return validation(result);
    });
  }

  std::shared_ptr<Handle> get_shared_secret(const Handle& handshake,
                                            SecurityException& exception) const override {
    return guarded(exception, std::shared_ptr<Handle>(), [&]() -> std::shared_ptr<Handle> {
      Erased found;
      std::vector<uint8_t> first(CHALLENGE), second(CHALLENGE);
      pqsec::handle_t peer;
      int64_t end;
      const int result =
          link_.ask(exception, "get_shared_secret", "h>hxcco", number_of(handshake), &peer, &end,
                    first.data(), second.data(), &found.octets);
      if (result < 0) return nullptr;
      sessions_.lasts_until(peer, end);
      auto secret = std::make_shared<PqsecSecret>();
      auto& data = (*secret)->data_;
      data.reserve(3);  // so that none is copied
      data.emplace_back(std::string("Challenge1"), std::move(first));
      data.emplace_back(std::string("Challenge2"), std::move(second));
      data.emplace_back(std::string("SharedSecret"), found.value());
      return secret;
    });
  }

  // 2.9 and 3.1 give none; see sessions.hpp.
  bool set_listener(AuthenticationListener*, SecurityException&) override { return true; }

  bool get_identity_token(DataHolder** token, const Handle& identity,
                          SecurityException& exception) override {
    sessions_.is_being_made();
    return guarded(exception, false, [&] {
      return link_.give(token, [&](agent::token* into) {
        return link_.ask(exception, "get_identity_token", "h>t", number_of(identity), into);
      });
    });
  }

  bool return_identity_token(DataHolder* token, SecurityException&) override {
    return pqsec::drop(token);
  }

  bool return_handshake_handle(Handle* handle, SecurityException& exception) override {
    const std::unique_ptr<PqsecHandshake> handshake(static_cast<PqsecHandshake*>(handle));
    if (handshake) link_.ask(exception, "return_handshake_handle", "h>", handshake->number);
    return true;
  }

  // For a peer that is not known yet.
  Handle* get_identity_handle(SecurityException& exception) override {
    return guarded<Handle*>(exception, nullptr, [] { return new pqsec::Identity(0); });
  }

  // This succeeds even if the agent has ended.
  bool return_identity_handle(Handle* handle, SecurityException& exception) override {
    const std::unique_ptr<pqsec::Identity> identity(static_cast<pqsec::Identity*>(handle));
    sessions_.remove(identity.get());
    if (identity && identity->number != 0)
      link_.ask(exception, "return_identity_handle", "h>", identity->number);
    return true;
  }

  bool return_sharedsecret_handle(std::shared_ptr<Handle>& secret,
                                  SecurityException&) const override {
    secret.reset();
    return true;
  }

  bool set_permissions_credential_and_token(Handle& identity, DataHolder& credential,
                                            SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const agent::token* no_permissions = nullptr;
      return link_.ask(exception, "set_permissions_credential_and_token", "htt>",
                       number_of(identity), Lent(credential).get(), no_permissions) >= 0;
    });
  }

  bool get_authenticated_peer_credential_token(DataHolder** token, const Handle& peer,
                                               SecurityException& exception) override {
    return guarded(exception, false, [&] {
      return link_.give(token, [&](agent::token* into) {
        const pqsec::handle_t handshake = static_cast<const pqsec::Identity&>(peer).handshake;
        return link_.ask(exception, "get_authenticated_peer_credential_token", "h>t", handshake,
                         into);
      });
    });
  }

  bool return_authenticated_peer_credential_token(DataHolder* token, SecurityException&) override {
    return pqsec::drop(token);
  }

#if PQSEC_MORE_FUNCTIONS
  GUID_t get_participant_guid(const Handle& handle) const override {
    return pqsec::guid_of(static_cast<const pqsec::Identity&>(handle).guid);
  }

  // Sessions needs no timer of its own.
  void set_event_resource(ResourceEvent&) override {}
#endif

  // Whether `adjusted` was derived from `original` for this identity. Called for discovery servers
  // that are configured by GUID. Fast DDS 2.9 does not have this function.
  bool check_guid_comes_from(Handle* identity, const GUID_t& adjusted, const GUID_t& original) {
    if (identity == nullptr) return false;
    const auto made = pqsec::octets_of(adjusted), candidate = pqsec::octets_of(original);
    SecurityException exception{std::string()};
    return guarded(exception, false, [&] {
      return link_.ask(exception, "check_guid_comes_from", "hgg>", number_of(*identity), &made,
                       &candidate) >= 0;
    });
  }

 private:
  static ValidationResult_t validation(int result) {
    return result < 0 ? VALIDATION_FAILED : static_cast<ValidationResult_t>(result);
  }

  static ValidationResult_t begun(int result, pqsec::handle_t number, const pqsec::Given& token,
                                  Handle& peer, Handle** handshake, DataHolder** message) {
    if (result < 0) return VALIDATION_FAILED;
    auto made = std::make_unique<PqsecHandshake>(number);
    made->message = token.holder();
    static_cast<pqsec::Identity&>(peer).handshake = number;
    *message = &made->message;
    *handshake = made.release();
    return validation(result);
  }

  pqsec::Link link_{"authentication"};
  mutable pqsec::Sessions sessions_{link_};
};

#pragma GCC visibility pop

}  // namespace PQSEC_RTPS::security

using Factory = void* (*)(void* self, const rtps::PropertyPolicy* policy);

PQSEC_EXPORT const char pqsec_build_id[] = PQSEC_BUILD_ID;

// The preload library returns it. Without memory the process ends: NULL would mean no security.
PQSEC_EXPORT void* pqsec_authentication(const rtps::PropertyPolicy* policy, Factory original,
                                        void* self) noexcept {
  using namespace rtps::security;
  if (!pqsec::is_secured(*policy)) return original(self, policy);
  return static_cast<Authentication*>(new PqsecAuthentication);
}
