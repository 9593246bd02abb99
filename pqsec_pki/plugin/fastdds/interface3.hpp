// The interface that Fast DDS 3.x calls, declared here because it installs no header for it.
//
// The order of virtual functions and their arguments are what the library's own tables of virtual
// functions name; `pqsec plugin install` compares the compiled adapter with them. Members are those
// that DDS-Security 1.1 gives these structures. Public headers are used where there are any. Objects
// of the library may be larger than their declarations here: the adapter never copies one.

#ifndef PQSEC_INTERFACE3_HPP
#define PQSEC_INTERFACE3_HPP

#include <cstddef>
#include <cstdint>
#include <exception>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <fastdds/rtps/attributes/EndpointSecurityAttributes.hpp>
#include <fastdds/rtps/attributes/PropertyPolicy.hpp>
#include <fastdds/rtps/attributes/RTPSParticipantAttributes.hpp>
#include <fastdds/rtps/builtin/data/ContentFilterProperty.hpp>
#include <fastdds/rtps/builtin/data/PublicationBuiltinTopicData.hpp>
#include <fastdds/rtps/builtin/data/SubscriptionBuiltinTopicData.hpp>
#include <fastdds/rtps/common/CDRMessage_t.hpp>
#include <fastdds/rtps/common/Guid.hpp>
#include <fastdds/rtps/common/Token.hpp>
#include <fastdds/rtps/common/VendorId_t.hpp>

#undef minor  // a macro of sys/sysmacros.h

namespace eprosima::fastdds::rtps {

class NetworkFactory;
class ParticipantProxyData;
class ResourceEvent;

// What the library knows of an endpoint. It has one pointer, to its virtual functions, before the
// structure that it derives from.
#if PQSEC_DERIVED
#define PQSEC_DERIVES_FROM(structure) : public structure
#define PQSEC_READER bool read_from_cdr_message(CDRMessage_t*, VendorId_t)
#else
#define PQSEC_DERIVES_FROM(structure)
#define PQSEC_READER \
  bool readFromCDRMessage(CDRMessage_t*, NetworkFactory&, bool, VendorId_t = c_VendorId_eProsima)
#endif

class WriterProxyData PQSEC_DERIVES_FROM(PublicationBuiltinTopicData) {
 public:
  WriterProxyData(size_t unicast_locators, size_t multicast_locators);
  virtual ~WriterProxyData();
  PQSEC_READER;
};

class ReaderProxyData PQSEC_DERIVES_FROM(SubscriptionBuiltinTopicData) {
 public:
  ReaderProxyData(size_t unicast_locators, size_t multicast_locators,
                  const ContentFilterProperty::AllocationConfiguration& = {});
  virtual ~ReaderProxyData();
  PQSEC_READER;
};

#if !PQSEC_DERIVED
// Exported by the library: what it has read of an endpoint, as a public structure.
void from_proxy_to_builtin(const WriterProxyData&, PublicationBuiltinTopicData&);
void from_proxy_to_builtin(const ReaderProxyData&, SubscriptionBuiltinTopicData&);
#endif

class Exception : public std::exception {
 public:
  ~Exception() throw() override;
  virtual void raise() const = 0;
  const char* what() const throw() override;

 protected:
  explicit Exception(const char* const& message, const int32_t minor);
  Exception& operator=(Exception&&);

 private:
  std::string message_;
  int32_t minor_;
};

namespace security {

class SecurityException : public Exception {
 public:
  explicit SecurityException(const std::string& message) : Exception(message.c_str(), 1) {}
  SecurityException& operator=(SecurityException&&);
  ~SecurityException() throw() override;
  void raise() const override;
};

class Handle : public std::enable_shared_from_this<Handle> {
 public:
  virtual bool nil() const = 0;

 protected:
  explicit Handle(const std::string& class_id) : class_id_(class_id) {}
  virtual ~Handle() {}

 private:
  std::string class_id_;
};

// A secret: the crypto plugin finds it by the class, and its three values by their names.
class SharedSecret {
 public:
  class BinaryData {
   public:
    BinaryData(std::string&& name, std::vector<uint8_t>&& value)
        : name_(std::move(name)), value_(std::move(value)) {}
    const std::string& name() const { return name_; }
    std::vector<uint8_t>& value() { return value_; }

   private:
    std::string name_;
    std::vector<uint8_t> value_;
  };

  static const char* const class_id_;
  std::vector<BinaryData> data_;
};

class PKIDH;

template <typename Content, typename Friend>
class HandleImpl : public Handle {
 public:
  bool nil() const override { return !content_; }
  Content* operator->() { return content_.get(); }

 protected:
  HandleImpl() : Handle(Content::class_id_), content_(new Content) {}
  ~HandleImpl() override = default;

 private:
  std::unique_ptr<Content> content_;
};

using SharedSecretHandle = HandleImpl<SharedSecret, PKIDH>;

struct ParticipantSecurityAttributes {
  bool allow_unauthenticated_participants;
  bool is_access_protected;
  bool is_rtps_protected;
  bool is_discovery_protected;
  bool is_liveliness_protected;
  uint32_t plugin_participant_attributes;
};

enum ValidationResult_t : uint32_t {
  VALIDATION_OK,
  VALIDATION_FAILED,
  VALIDATION_PENDING_RETRY,
  VALIDATION_PENDING_HANDSHAKE_REQUEST,
  VALIDATION_PENDING_HANDSHAKE_MESSAGE,
  VALIDATION_OK_WITH_FINAL_MESSAGE
};

class AuthenticationListener;
class Logging;

#if PQSEC_BY_PROPERTIES
using Described = PropertyPolicy;
#else
using Described = RTPSParticipantAttributes;
#endif

class Authentication {
 public:
  virtual ~Authentication() = default;
  virtual ValidationResult_t validate_local_identity(Handle**, GUID_t&, const uint32_t,
                                                     const Described&, const GUID_t&,
                                                     SecurityException&) = 0;
  virtual ValidationResult_t validate_remote_identity(Handle**, const Handle&, const DataHolder&,
                                                      const GUID_t&, SecurityException&) = 0;
  virtual ValidationResult_t begin_handshake_request(Handle**, DataHolder**, const Handle&,
                                                     Handle&, const CDRMessage_t&,
                                                     SecurityException&) = 0;
  virtual ValidationResult_t begin_handshake_reply(Handle**, DataHolder**, DataHolder&&, Handle&,
                                                   const Handle&, const CDRMessage_t&,
                                                   SecurityException&) = 0;
  virtual ValidationResult_t process_handshake(DataHolder**, DataHolder&&, Handle&,
                                               SecurityException&) = 0;
  virtual std::shared_ptr<Handle> get_shared_secret(const Handle&, SecurityException&) const = 0;
  virtual bool set_listener(AuthenticationListener*, SecurityException&) = 0;
  virtual bool get_identity_token(DataHolder**, const Handle&, SecurityException&) = 0;
  virtual bool return_identity_token(DataHolder*, SecurityException&) = 0;
  virtual bool return_handshake_handle(Handle*, SecurityException&) = 0;
  virtual Handle* get_identity_handle(SecurityException&) = 0;
  virtual bool return_identity_handle(Handle*, SecurityException&) = 0;
  virtual bool return_sharedsecret_handle(std::shared_ptr<Handle>&, SecurityException&) const = 0;
  virtual bool set_permissions_credential_and_token(Handle&, DataHolder&, SecurityException&) = 0;
  virtual bool get_authenticated_peer_credential_token(DataHolder**, const Handle&,
                                                       SecurityException&) = 0;
  virtual bool return_authenticated_peer_credential_token(DataHolder*, SecurityException&) = 0;
  virtual bool check_guid_comes_from(Handle*, const GUID_t&, const GUID_t&) = 0;
#if PQSEC_MORE_FUNCTIONS
  virtual GUID_t get_participant_guid(const Handle&) const = 0;
  virtual void set_event_resource(ResourceEvent&) = 0;
#endif

 private:
  Logging* logger_ = nullptr;  // the stack writes it
};

class AccessControl {
 public:
  using Strings = std::vector<std::string>;

  virtual ~AccessControl() = default;
  virtual Handle* validate_local_permissions(Authentication&, const Handle&, const uint32_t,
                                             const Described&, SecurityException&) = 0;
  virtual bool get_permissions_token(DataHolder**, const Handle&, SecurityException&) = 0;
  virtual bool return_permissions_token(DataHolder*, SecurityException&) = 0;
  virtual bool get_permissions_credential_token(DataHolder**, const Handle&,
                                                SecurityException&) = 0;
  virtual bool return_permissions_credential_token(DataHolder*, SecurityException&) = 0;
  virtual Handle* get_permissions_handle(SecurityException&) = 0;
  virtual bool return_permissions_handle(Handle*, SecurityException&) = 0;
  virtual Handle* validate_remote_permissions(Authentication&, const Handle&, const Handle&,
                                              const Handle&, const DataHolder&, const DataHolder&,
                                              SecurityException&) = 0;
#if PQSEC_BY_PROPERTIES
  virtual bool check_create_participant(const Handle&, const uint32_t, SecurityException&) = 0;
#else
  virtual bool check_create_participant(const Handle&, const uint32_t, const Described&,
                                        SecurityException&) = 0;
#endif
  virtual bool check_remote_participant(const Handle&, const uint32_t, const ParticipantProxyData&,
                                        SecurityException&) = 0;
  virtual bool check_create_datawriter(const Handle&, const uint32_t, const std::string&,
                                       const Strings&, SecurityException&) = 0;
  virtual bool check_create_datareader(const Handle&, const uint32_t, const std::string&,
                                       const Strings&, SecurityException&) = 0;
  virtual bool check_remote_datawriter(const Handle&, const uint32_t, const WriterProxyData&,
                                       SecurityException&) = 0;
  virtual bool check_remote_datareader(const Handle&, const uint32_t, const ReaderProxyData&,
                                       bool&, SecurityException&) = 0;
  virtual bool get_participant_sec_attributes(const Handle&, ParticipantSecurityAttributes&,
                                              SecurityException&) = 0;
  virtual bool get_datawriter_sec_attributes(const Handle&, const std::string&, const Strings&,
                                             EndpointSecurityAttributes&, SecurityException&) = 0;
  virtual bool get_datareader_sec_attributes(const Handle&, const std::string&, const Strings&,
                                             EndpointSecurityAttributes&, SecurityException&) = 0;

 private:
  Logging* logger_ = nullptr;  // the stack writes it
};

}  // namespace security
}  // namespace eprosima::fastdds::rtps

#endif
