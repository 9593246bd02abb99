// The access control plugin: DDS-Security 1.1, 8.4.2.9. The shim asks the agent.

#include <atomic>
#include <cstdio>

#include "stack.hpp"

namespace pqsec {
namespace {

using agent::handle_t;

class AccessControl : public virtual OpenDDS::DCPS::LocalObject<security::AccessControl> {
 public:
  AccessControl(agent::access_control* shim, std::shared_ptr<Known> known)
      : shim_(shim), known_of_both_(std::move(known)), known_(*known_of_both_) {
    current = this;
    listener_.on_revoke = on_revoke;
    ask<uint8_t(const agent::listener*)>(unheard_, shim_, shim_->set_listener, &listener_);
  }

  // OpenDDS drops its plugins when it is shut down: the shim's thread ends first.
  ~AccessControl() override {
    agent::finalize_access_control(shim_);
    current = nullptr;
  }

  security::PermissionsHandle validate_local_permissions(
      security::Authentication*, security::IdentityHandle identity, security::DomainId_t domain,
      const DDS::DomainParticipantQos& qos, SecurityException& exception) override {
    return guarded(exception, 0, [&] {
      const void* no_plugin = nullptr;
      const Settings settings(qos.property);
      const handle_t handle = ask<handle_t(const void*, handle_t, int32_t, const agent::qos*)>(
          exception, shim_, shim_->validate_local_permissions, no_plugin, known_.handle(identity),
          domain, settings.get());
      const int32_t number = known_.number(handle);
      const std::lock_guard<std::mutex> guard(known_.mutex);
      if (number != 0) known_.permissions.add_own(identity, number);
      return number;
    });
  }

  security::PermissionsHandle validate_remote_permissions(
      security::Authentication*, security::IdentityHandle identity, security::IdentityHandle peer,
      const security::PermissionsToken& permissions,
      const security::AuthenticatedPeerCredentialToken& credential,
      SecurityException& exception) override {
    return guarded(exception, 0, [&] {
      const void* no_plugin = nullptr;
      const handle_t handle = ask<handle_t(const void*, handle_t, handle_t, const agent::token*,
                                           const agent::token*)>(
          exception, shim_, shim_->validate_remote_permissions, no_plugin, known_.handle(identity),
          known_.handle(peer), Lent(permissions).get(), Lent(credential).get());
      const int32_t number = known_.number(handle);
      if (number == 0) {
        known_.refuse_peer(peer, text(exception.message));
        return 0;
      }
      const std::lock_guard<std::mutex> guard(known_.mutex);
      known_.permissions.add_peers(number, identity, peer);
      return number;
    });
  }

  CORBA::Boolean check_create_participant(security::PermissionsHandle permissions,
                                          security::DomainId_t domain,
                                          const DDS::DomainParticipantQos&,
                                          SecurityException& exception) override {
    return may_join(shim_->check_create_participant, permissions, domain, exception);
  }

  CORBA::Boolean check_create_datawriter(security::PermissionsHandle permissions,
                                         security::DomainId_t domain, const char* topic,
                                         const DDS::DataWriterQos&,
                                         const DDS::PartitionQosPolicy& partition,
                                         const security::DataTags& tags,
                                         SecurityException& exception) override {
    return may_create(shim_->check_create_datawriter, permissions, domain, topic, partition, tags,
                      exception);
  }

  CORBA::Boolean check_create_datareader(security::PermissionsHandle permissions,
                                         security::DomainId_t domain, const char* topic,
                                         const DDS::DataReaderQos&,
                                         const DDS::PartitionQosPolicy& partition,
                                         const security::DataTags& tags,
                                         SecurityException& exception) override {
    return may_create(shim_->check_create_datareader, permissions, domain, topic, partition, tags,
                      exception);
  }

  CORBA::Boolean check_create_topic(security::PermissionsHandle permissions,
                                    security::DomainId_t domain, const char* topic,
                                    const DDS::TopicQos&, SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const agent::qos* no_qos = nullptr;
      return ask<uint8_t(handle_t, int32_t, const char*, const agent::qos*)>(
                 exception, shim_, shim_->check_create_topic, known_.handle(permissions), domain,
                 standard_topic(topic), no_qos) != 0;
    });
  }

  CORBA::Boolean check_remote_participant(security::PermissionsHandle permissions,
                                          security::DomainId_t domain,
                                          const security::ParticipantBuiltinTopicDataSecure&,
                                          SecurityException& exception) override {
    return guarded(exception, false, [&] {
      if (may_join(shim_->check_remote_participant, permissions, domain, exception)) return true;
      int32_t peer;
      {
        const std::lock_guard<std::mutex> guard(known_.mutex);
        peer = known_.permissions.peer(permissions);
      }
      known_.refuse_peer(peer, text(exception.message));
      return false;
    });
  }

  CORBA::Boolean check_remote_datawriter(security::PermissionsHandle permissions,
                                         security::DomainId_t domain,
                                         const security::PublicationBuiltinTopicDataSecure& found,
                                         SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const Endpoint<agent::publication> endpoint(found);
      return ask<uint8_t(handle_t, int32_t, const agent::publication*)>(
                 exception, shim_, shim_->check_remote_datawriter, known_.handle(permissions),
                 domain, endpoint.get()) != 0;
    });
  }

  CORBA::Boolean check_remote_datareader(security::PermissionsHandle permissions,
                                         security::DomainId_t domain,
                                         const security::SubscriptionBuiltinTopicDataSecure& found,
                                         CORBA::Boolean& relay_only,
                                         SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const Endpoint<agent::subscription> endpoint(found);
      uint8_t relays = 0;
      const bool may = ask<uint8_t(handle_t, int32_t, const agent::subscription*, uint8_t*)>(
                           exception, shim_, shim_->check_remote_datareader,
                           known_.handle(permissions), domain, endpoint.get(), &relays) != 0;
      relay_only = relays != 0;
      return may;
    });
  }

  CORBA::Boolean check_remote_topic(security::PermissionsHandle permissions,
                                    security::DomainId_t domain,
                                    const DDS::TopicBuiltinTopicData& found,
                                    SecurityException& exception) override {
    return guarded(exception, false, [&] {
      const agent::topic topic = {{}, text(found.name), text(found.type_name)};
      return ask<uint8_t(handle_t, int32_t, const agent::topic*)>(
                 exception, shim_, shim_->check_remote_topic, known_.handle(permissions), domain,
                 &topic) != 0;
    });
  }

  // Permissions documents do not restrict instances and matches.
  CORBA::Boolean check_local_datawriter_register_instance(security::PermissionsHandle,
                                                          DDS::DataWriter_ptr, Key,
                                                          SecurityException&) override {
    return true;
  }
  CORBA::Boolean check_local_datawriter_dispose_instance(security::PermissionsHandle,
                                                         DDS::DataWriter_ptr, Key,
                                                         SecurityException&) override {
    return true;
  }
  CORBA::Boolean check_local_datawriter_match(security::PermissionsHandle,
                                              security::PermissionsHandle,
                                              const security::PublicationBuiltinTopicDataSecure&,
                                              const security::SubscriptionBuiltinTopicDataSecure&,
                                              SecurityException&) override {
    return true;
  }
  CORBA::Boolean check_local_datareader_match(security::PermissionsHandle,
                                              security::PermissionsHandle,
                                              const security::SubscriptionBuiltinTopicDataSecure&,
                                              const security::PublicationBuiltinTopicDataSecure&,
                                              SecurityException&) override {
    return true;
  }
  CORBA::Boolean check_remote_datawriter_dispose_instance(security::PermissionsHandle,
                                                          DDS::DataReader_ptr,
                                                          DDS::InstanceHandle_t, Key,
                                                          SecurityException&) override {
    return true;
  }
  // The first is 3.13's, the second 3.34's; OpenDDS calls only the one that it has.
  virtual CORBA::Boolean check_remote_datawriter_register_instance(
      security::PermissionsHandle, DDS::DataReader_ptr, DDS::InstanceHandle_t, Key,
      DDS::InstanceHandle_t, SecurityException&) {
    return true;
  }
  virtual CORBA::Boolean check_remote_datawriter_register_instance(security::PermissionsHandle,
                                                                   DDS::DataReader_ptr,
                                                                   DDS::InstanceHandle_t, Key,
                                                                   SecurityException&) {
    return true;
  }

  CORBA::Boolean get_permissions_token(security::PermissionsToken& token,
                                       security::PermissionsHandle permissions,
                                       SecurityException& exception) override {
    return give(token, exception, shim_->get_permissions_token, permissions);
  }

  CORBA::Boolean get_permissions_credential_token(security::PermissionsCredentialToken& token,
                                                  security::PermissionsHandle permissions,
                                                  SecurityException& exception) override {
    return give(token, exception, shim_->get_permissions_credential_token, permissions);
  }

  // OpenDDS itself sets none, in 3.13 and 3.34; a program can.
  CORBA::Boolean set_listener(security::AccessControlListener* listener,
                              SecurityException&) override {
    const std::lock_guard<std::mutex> guard(known_.mutex);
    told_ = security::AccessControlListener::_duplicate(listener);
    return true;
  }

  CORBA::Boolean return_permissions_token(const security::PermissionsToken&,
                                          SecurityException&) override {
    return true;
  }
  CORBA::Boolean return_permissions_credential_token(const security::PermissionsCredentialToken&,
                                                     SecurityException&) override {
    return true;
  }

  CORBA::Boolean get_participant_sec_attributes(
      security::PermissionsHandle permissions,
      security::ParticipantSecurityAttributes& attributes, SecurityException& exception) override {
    return guarded(exception, false, [&] {
      agent::participant_attributes found{};
      if (!ask<uint8_t(handle_t, agent::participant_attributes*)>(
              exception, shim_, shim_->get_participant_sec_attributes,
              known_.governing(permissions), &found))
        return false;
      attributes.allow_unauthenticated_participants = found.unauthenticated != 0;
      attributes.is_access_protected = found.access != 0;
      attributes.is_rtps_protected = found.rtps != 0;
      attributes.is_discovery_protected = found.discovery != 0;
      attributes.is_liveliness_protected = found.liveliness != 0;
      attributes.plugin_participant_attributes = found.plugin;
      attributes.ac_endpoint_properties.length(0);
      return true;
    });
  }

  CORBA::Boolean get_topic_sec_attributes(security::PermissionsHandle permissions,
                                          const char* topic,
                                          security::TopicSecurityAttributes& attributes,
                                          SecurityException& exception) override {
    return guarded(exception, false, [&] {
      agent::topic_attributes found{};
      if (!ask<uint8_t(handle_t, const char*, agent::topic_attributes*)>(
              exception, shim_, shim_->get_topic_sec_attributes, known_.governing(permissions),
              standard_topic(topic), &found))
        return false;
      copy(found, attributes);
      return true;
    });
  }

  CORBA::Boolean get_datawriter_sec_attributes(security::PermissionsHandle permissions,
                                               const char* topic,
                                               const DDS::PartitionQosPolicy& partition,
                                               const security::DataTagQosPolicy& tags,
                                               security::EndpointSecurityAttributes& attributes,
                                               SecurityException& exception) override {
    return protection(shim_->get_datawriter_sec_attributes, permissions, topic, partition, tags,
                      attributes, exception);
  }

  CORBA::Boolean get_datareader_sec_attributes(security::PermissionsHandle permissions,
                                               const char* topic,
                                               const DDS::PartitionQosPolicy& partition,
                                               const security::DataTagQosPolicy& tags,
                                               security::EndpointSecurityAttributes& attributes,
                                               SecurityException& exception) override {
    return protection(shim_->get_datareader_sec_attributes, permissions, topic, partition, tags,
                      attributes, exception);
  }

  CORBA::Boolean return_participant_sec_attributes(const security::ParticipantSecurityAttributes&,
                                                   SecurityException&) override {
    return true;
  }
  CORBA::Boolean return_datawriter_sec_attributes(const security::EndpointSecurityAttributes&,
                                                  SecurityException&) override {
    return true;
  }
  CORBA::Boolean return_datareader_sec_attributes(const security::EndpointSecurityAttributes&,
                                                  SecurityException&) override {
    return true;
  }

  // 3.13 does not have it.
  virtual CORBA::Boolean return_permissions_handle(security::PermissionsHandle permissions,
                                                   SecurityException& exception) {
    return guarded(exception, false, [&] {
      const bool done = ask<uint8_t(handle_t)>(exception, shim_, shim_->return_permissions_handle,
                                               known_.handle(permissions)) != 0;
      const std::lock_guard<std::mutex> guard(known_.mutex);
      known_.permissions.drop(permissions);
      known_.handles.drop(permissions);
      return done;
    });
  }

 private:
  // What discovery says of an endpoint, as far as the shim reads it.
  template <typename Data>
  class Endpoint {
   public:
    template <typename Found>
    explicit Endpoint(const Found& found)
        : partition_(found.base.base.partition.name), tags_(found.data_tags.tags) {
      data_.topic = text(found.base.base.topic_name);
      data_.type = text(found.base.base.type_name);
      data_.partition = *partition_.get();
      data_.tags = *tags_.get();
    }
    const Data* get() const { return &data_; }

   private:
    List partition_;
    Tags tags_;
    Data data_{};
  };

  template <typename To>
  static void copy(const agent::topic_attributes& from, To& to) {
    to.is_read_protected = from.read != 0;
    to.is_write_protected = from.write != 0;
    to.is_discovery_protected = from.discovery != 0;
    to.is_liveliness_protected = from.liveliness != 0;
  }

  bool may_join(agent::function function, int32_t permissions, int32_t domain,
                SecurityException& exception) {
    return guarded(exception, false, [&] {
      const void* nothing_more = nullptr;
      return ask<uint8_t(handle_t, int32_t, const void*)>(
                 exception, shim_, function, known_.handle(permissions), domain, nothing_more) != 0;
    });
  }

  bool may_create(agent::function function, int32_t permissions, int32_t domain, const char* topic,
                  const DDS::PartitionQosPolicy& partition, const security::DataTags& tags,
                  SecurityException& exception) {
    return guarded(exception, false, [&] {
      const agent::qos* no_qos = nullptr;
      return ask<uint8_t(handle_t, int32_t, const char*, const agent::qos*, const agent::strings*,
                         const agent::tags*)>(exception, shim_, function,
                                              known_.handle(permissions), domain,
                                              standard_topic(topic), no_qos,
                                              List(partition.name).get(),
                                              Tags(tags.tags).get()) != 0;
    });
  }

  bool protection(agent::function function, int32_t permissions, const char* topic,
                  const DDS::PartitionQosPolicy& partition, const security::DataTagQosPolicy& tags,
                  security::EndpointSecurityAttributes& attributes, SecurityException& exception) {
    return guarded(exception, false, [&] {
      agent::endpoint_attributes found{};
      if (!ask<uint8_t(handle_t, const char*, const agent::strings*, const agent::tags*,
                       agent::endpoint_attributes*)>(
              exception, shim_, function, known_.governing(permissions), standard_topic(topic),
              List(partition.name).get(), Tags(tags.tags).get(), &found))
        return false;
      copy({found.read, found.write, found.discovery, found.liveliness}, attributes.base);
      attributes.is_submessage_protected = found.submessage != 0;
      attributes.is_payload_protected = found.payload != 0;
      attributes.is_key_protected = found.key != 0;
      attributes.plugin_endpoint_attributes = found.plugin;
      attributes.ac_endpoint_properties.length(0);
      return true;
    });
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

  // The shim's watch calls it, from its own thread.
  static uint8_t on_revoke(const void*, handle_t handle) {
    AccessControl* const self = current;
    SecurityException exception;
    return guarded(exception, false, [&] {
      security::AccessControlListener_var told;
      int32_t permissions;
      {
        const std::lock_guard<std::mutex> guard(self->known_.mutex);
        permissions = self->known_.handles.find(handle);
        told = self->told_;
      }
      if (permissions == 0) return true;
      if (told.in() == nullptr) {
        fprintf(stderr,
                "pqsec: the permissions of a participant expired: OpenDDS does not disconnect"
                " it\n");
        return true;
      }
      return static_cast<bool>(told->on_revoke_permissions(self, permissions));
    });
  }

  static std::atomic<AccessControl*> current;  // there is one in a process

  agent::access_control* const shim_;
  const std::shared_ptr<Known> known_of_both_;
  Known& known_;
  agent::listener listener_;
  security::AccessControlListener_var told_;
  SecurityException unheard_;
};

std::atomic<AccessControl*> AccessControl::current{nullptr};

}  // namespace

security::AccessControl* make_access_control(const std::shared_ptr<Known>& known) {
  void* shim = nullptr;
  if (agent::init_access_control("", &shim, nullptr) != 0) return nullptr;
  return new AccessControl(static_cast<agent::access_control*>(shim), known);
}

}  // namespace pqsec
