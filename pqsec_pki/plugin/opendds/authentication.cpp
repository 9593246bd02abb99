// The authentication plugin: DDS-Security 1.1, 8.3.2.7. The shim asks the agent.

#include <atomic>
#include <cstdio>

#include "stack.hpp"

namespace pqsec {
namespace {

using agent::handle_t;
using security::ValidationResult_t;
using Validation = ValidationResult_t;

enum { CHALLENGE = 32 };  // octets

// OpenDDS wants an object, and gives up a peer without returning it: it has its own copy.
class Secret : public virtual OpenDDS::DCPS::LocalObject<security::SharedSecretHandle> {
 public:
  explicit Secret(const agent::shared_secret& from) {
    copy(challenge1_, from.challenge1, CHALLENGE);
    copy(challenge2_, from.challenge2, CHALLENGE);
    copy(secret_, from.secret, static_cast<CORBA::ULong>(from.size));
  }
  ~Secret() override { explicit_bzero(secret_.get_buffer(), secret_.length()); }

  DDS::OctetSeq* challenge1() override { return new DDS::OctetSeq(challenge1_); }
  DDS::OctetSeq* challenge2() override { return new DDS::OctetSeq(challenge2_); }
  DDS::OctetSeq* sharedSecret() override { return new DDS::OctetSeq(secret_); }

 private:
  static void copy(DDS::OctetSeq& to, const uint8_t* from, CORBA::ULong size) {
    to.length(size);
    if (size != 0) memcpy(to.get_buffer(), from, size);
  }

  DDS::OctetSeq challenge1_, challenge2_, secret_;
};

class Authentication : public virtual OpenDDS::DCPS::LocalObject<security::Authentication> {
 public:
  Authentication(agent::authentication* shim, std::shared_ptr<Known> known)
      : shim_(shim), known_of_both_(std::move(known)), known_(*known_of_both_) {
    current = this;
    listener_.on_revoke = on_revoke;
    ask<uint8_t(const agent::listener*)>(unheard_, shim_, shim_->set_listener, &listener_);
  }

  // OpenDDS drops its plugins when it is shut down: the shim's thread ends first.
  ~Authentication() override {
    agent::finalize_authentication(shim_);
    current = nullptr;
  }

  Validation validate_local_identity(security::IdentityHandle& identity, GUID_t& adjusted,
                                     security::DomainId_t domain,
                                     const DDS::DomainParticipantQos& qos, const GUID_t& candidate,
                                     SecurityException& exception) override {
    return guarded(exception, security::VALIDATION_FAILED, [&] {
      const Settings settings(qos.property);
      handle_t handle = 0;
      agent::guid before, after;
      memcpy(&before, &candidate, sizeof before);
      const int result =
          ask<int(handle_t*, agent::guid*, int32_t, const agent::qos*, const agent::guid*)>(
              exception, shim_, shim_->validate_local_identity, &handle, &after, domain,
              settings.get(), &before);
      if (result != security::VALIDATION_OK) return security::VALIDATION_FAILED;
      memcpy(&adjusted, &after, sizeof after);
      identity = known_.number(handle);
      return identity != 0 ? security::VALIDATION_OK : security::VALIDATION_FAILED;
    });
  }

  CORBA::Boolean get_identity_token(security::IdentityToken& token, security::IdentityHandle identity,
                                    SecurityException& exception) override {
    return give(token, exception, shim_->get_identity_token, identity);
  }

  CORBA::Boolean get_identity_status_token(security::IdentityStatusToken& token,
                                           security::IdentityHandle, SecurityException&) override {
    token = security::IdentityStatusToken();
    return true;  // there is none
  }

  CORBA::Boolean set_permissions_credential_and_token(
      security::IdentityHandle identity, const security::PermissionsCredentialToken& credential,
      const security::PermissionsToken& permissions, SecurityException& exception) override {
    return guarded(exception, false, [&] {
      return ask<uint8_t(handle_t, const agent::token*, const agent::token*)>(
                 exception, shim_, shim_->set_permissions_credential_and_token,
                 known_.handle(identity), Lent(credential).get(), Lent(permissions).get()) != 0;
    });
  }

  Validation validate_remote_identity(security::IdentityHandle& peer,
                                      security::AuthRequestMessageToken& own_request,
                                      const security::AuthRequestMessageToken& peers_request,
                                      security::IdentityHandle identity,
                                      const security::IdentityToken& token, const GUID_t& guid,
                                      SecurityException& exception) override {
    return guarded(exception, security::VALIDATION_FAILED, [&] {
      const Lent said(token), heard(peers_request);
      agent::guid octets;
      memcpy(&octets, &guid, sizeof octets);
      std::string question = asked("identity", identity, 0, said);
      question.append(reinterpret_cast<const char*>(octets.octets), sizeof octets.octets);
      if (is_refused(question, exception)) return security::VALIDATION_FAILED;
      handle_t handle = 0;
      Given given;
      const int result =
          ask<int(handle_t*, agent::token*, const agent::token*, handle_t, const agent::token*,
                  const agent::guid*)>(exception, shim_, shim_->validate_remote_identity, &handle,
                                       given.get(), heard.get(), known_.handle(identity),
                                       said.get(), &octets);
      if (result == security::VALIDATION_FAILED) return refuse(std::move(question), exception);
      given.copy_to(own_request);
      peer = known_.number(handle);
      if (peer == 0) return security::VALIDATION_FAILED;
      const std::lock_guard<std::mutex> guard(known_.mutex);
      known_.peers[peer].question = std::move(question);
      return static_cast<Validation>(result);
    });
  }

  Validation begin_handshake_request(security::HandshakeHandle& handshake,
                                     security::HandshakeMessageToken& message,
                                     security::IdentityHandle identity,
                                     security::IdentityHandle peer, const DDS::OctetSeq& data,
                                     SecurityException& exception) override {
    return guarded(exception, security::VALIDATION_FAILED, [&] {
      const agent::octets lent = octets(data);
      handle_t handle = 0;
      Given given;
      const int result =
          ask<int(handle_t*, agent::token*, handle_t, handle_t, const agent::octets*)>(
              exception, shim_, shim_->begin_handshake_request, &handle, given.get(),
              known_.handle(identity), known_.handle(peer), &lent);
      return begun(result, handle, given, peer, handshake, message);
    });
  }

  // `message` has the peer's Request, and then our Reply.
  Validation begin_handshake_reply(security::HandshakeHandle& handshake,
                                   security::HandshakeMessageToken& message,
                                   security::IdentityHandle peer, security::IdentityHandle identity,
                                   const DDS::OctetSeq& data,
                                   SecurityException& exception) override {
    return guarded(exception, security::VALIDATION_FAILED, [&] {
      const Lent request(message);
      std::string question = asked("reply", identity, peer, request);
      if (is_refused(question, exception)) return security::VALIDATION_FAILED;
      const agent::octets lent = octets(data);
      handle_t handle = 0;
      Given given;
      const int result = ask<int(handle_t*, agent::token*, const agent::token*, handle_t, handle_t,
                                 const agent::octets*)>(
          exception, shim_, shim_->begin_handshake_reply, &handle, given.get(), request.get(),
          known_.handle(peer), known_.handle(identity), &lent);
      if (result == security::VALIDATION_FAILED) return refuse(std::move(question), exception);
      return begun(result, handle, given, peer, handshake, message);
    });
  }

  Validation process_handshake(security::HandshakeMessageToken& answer,
                               const security::HandshakeMessageToken& message,
                               security::HandshakeHandle handshake,
                               SecurityException& exception) override {
    return guarded(exception, security::VALIDATION_FAILED, [&] {
      const Lent lent(message);
      std::string question = asked("message", handshake, 0, lent);
      if (is_refused(question, exception)) return security::VALIDATION_FAILED;
      Given given;
      const int result = ask<int(agent::token*, const agent::token*, handle_t)>(
          exception, shim_, shim_->process_handshake, given.get(), lent.get(),
          known_.handle(handshake));
      if (result == security::VALIDATION_FAILED) return refuse(std::move(question), exception);
      given.copy_to(answer);
      return static_cast<Validation>(result);
    });
  }

  security::SharedSecretHandle* get_shared_secret(security::HandshakeHandle handshake,
                                                  SecurityException& exception) override {
    return guarded(exception, static_cast<security::SharedSecretHandle*>(nullptr), [&] {
      const handle_t found = ask<handle_t(handle_t)>(exception, shim_, shim_->get_shared_secret,
                                                     known_.handle(handshake));
      return found == 0 ? nullptr
                        : new Secret(*reinterpret_cast<const agent::shared_secret*>(found));
    });
  }

  CORBA::Boolean get_authenticated_peer_credential_token(
      security::AuthenticatedPeerCredentialToken& token, security::HandshakeHandle handshake,
      SecurityException& exception) override {
    return give(token, exception, shim_->get_authenticated_peer_credential_token, handshake);
  }

  // OpenDDS itself sets none, in 3.13 and 3.34; a program can.
  CORBA::Boolean set_listener(security::AuthenticationListener* listener,
                              SecurityException&) override {
    const std::lock_guard<std::mutex> guard(known_.mutex);
    told_ = security::AuthenticationListener::_duplicate(listener);
    return true;
  }

  CORBA::Boolean return_identity_token(const security::IdentityToken&,
                                       SecurityException&) override {
    return true;
  }
  CORBA::Boolean return_identity_status_token(const security::IdentityStatusToken&,
                                              SecurityException&) override {
    return true;
  }
  CORBA::Boolean return_authenticated_peer_credential_token(
      const security::AuthenticatedPeerCredentialToken&, SecurityException&) override {
    return true;
  }

  CORBA::Boolean return_handshake_handle(security::HandshakeHandle handshake,
                                         SecurityException& exception) override {
    return drop(handshake, exception, shim_->return_handshake_handle);
  }

  CORBA::Boolean return_identity_handle(security::IdentityHandle identity,
                                        SecurityException& exception) override {
    {
      const std::lock_guard<std::mutex> guard(known_.mutex);
      known_.peers.erase(identity);
    }
    return drop(identity, exception, shim_->return_identity_handle);
  }

  CORBA::Boolean return_sharedsecret_handle(security::SharedSecretHandle*,
                                            SecurityException&) override {
    return true;  // it is erased when nothing refers to it
  }

 private:
  static std::string asked(const char* what, int32_t one, int32_t other, const Lent& token) {
    return std::string(what) + " " + std::to_string(one) + " " + std::to_string(other) + " " +
           token.all_octets();
  }

  bool is_refused(const std::string& question, SecurityException& exception) {
    std::string why;
    if (!known_.is_refused(question, why)) return false;
    tell(exception, why);
    return true;
  }

  Validation refuse(std::string question, const SecurityException& exception) {
    known_.refuse(std::move(question), text(exception.message));
    return security::VALIDATION_FAILED;
  }

  // A peer has one handshake: OpenDDS forgets an earlier one without returning it.
  Validation begun(int result, handle_t handle, const Given& given, int32_t peer,
                   security::HandshakeHandle& handshake, security::HandshakeMessageToken& message) {
    if (result == security::VALIDATION_FAILED) return security::VALIDATION_FAILED;
    given.copy_to(message);
    handshake = known_.number(handle);
    const std::lock_guard<std::mutex> guard(known_.mutex);
    int32_t& latest = known_.peers[peer].handshake;
    if (latest != handshake) known_.handles.drop(latest);
    latest = handshake;
    return handshake != 0 ? static_cast<Validation>(result) : security::VALIDATION_FAILED;
  }

  template <typename Token>
  bool give(Token& token, SecurityException& exception, agent::function function, int32_t number) {
    return guarded(exception, false, [&] {
      Given given;
      if (!ask<uint8_t(agent::token*, handle_t)>(exception, shim_, function, given.get(),
                                                 known_.handle(number)))
        return false;
      given.copy_to(token);
      return true;
    });
  }

  bool drop(int32_t number, SecurityException& exception, agent::function function) {
    return guarded(exception, false, [&] {
      const bool done =
          ask<uint8_t(handle_t)>(exception, shim_, function, known_.handle(number)) != 0;
      const std::lock_guard<std::mutex> guard(known_.mutex);
      known_.handles.drop(number);
      return done;
    });
  }

  // The shim's watch calls it, from its own thread.
  static uint8_t on_revoke(const void*, handle_t handle) {
    Authentication* const self = current;
    SecurityException exception;
    return guarded(exception, false, [&] {
      security::AuthenticationListener_var told;
      int32_t identity;
      {
        const std::lock_guard<std::mutex> guard(self->known_.mutex);
        identity = self->known_.handles.find(handle);
        told = self->told_;
      }
      if (identity == 0) return true;
      if (told.in() == nullptr) {
        fprintf(stderr,
                "pqsec: a participant was revoked, or its identity expired: OpenDDS does not"
                " disconnect it\n");
        return true;
      }
      return told->on_revoke_identity(self, identity, exception);
    });
  }

  static std::atomic<Authentication*> current;  // there is one in a process

  agent::authentication* const shim_;
  const std::shared_ptr<Known> known_of_both_;
  Known& known_;
  agent::listener listener_;
  security::AuthenticationListener_var told_;
  SecurityException unheard_;
};

std::atomic<Authentication*> Authentication::current{nullptr};

}  // namespace

security::Authentication* make_authentication(const std::shared_ptr<Known>& known) {
  void* shim = nullptr;
  if (agent::init_authentication("", &shim, nullptr) != 0) return nullptr;
  return new Authentication(static_cast<agent::authentication*>(shim), known);
}

}  // namespace pqsec
