// The parts of OpenDDS that the adapter uses, and what differs between versions, told by the
// user's headers alone.

#ifndef PQSEC_STACK_HPP
#define PQSEC_STACK_HPP

#include <dds/DCPS/LocalObject.h>
#include <dds/DCPS/RcHandle_T.h>
#include <dds/DCPS/security/framework/SecurityConfig.h>
#include <dds/DCPS/security/framework/SecurityPluginInst.h>
#include <dds/DCPS/security/framework/SecurityRegistry.h>
#include <dds/DdsSecurityCoreC.h>

#include <ctime>
#include <memory>
#include <mutex>
#include <string>
#include <type_traits>
#include <utility>

#include "handles.hpp"
#include "shim.hpp"
#include "values.hpp"

namespace pqsec {

namespace security = DDS::Security;
using OpenDDS::DCPS::GUID_t;
using security::SecurityException;

static_assert(sizeof(GUID_t) == sizeof(agent::guid), "a GUID has 16 octets");
static_assert(static_cast<int>(security::VALIDATION_FAILED) == agent::VALIDATION_FAILED &&
                  static_cast<int>(security::VALIDATION_OK_FINAL_MESSAGE) == agent::VALIDATION_LAST,
              "the results have the standard's numbers");

// The last parameter but one of a function that is asked about an instance: its class was moved.
template <typename Handle, typename Entity, typename Key>
Key key_of(CORBA::Boolean (security::AccessControl::*)(Handle, Entity, Key, SecurityException&));
using Key = decltype(key_of(&security::AccessControl::check_local_datawriter_register_instance));

// Later versions ask a plugin for a further object, which the builtin one has.
template <typename Config, typename = void>
class WithUtility : public OpenDDS::Security::SecurityPluginInst {
 protected:
  explicit WithUtility(const Config&) {}
};

template <typename Config>
class WithUtility<Config, decltype(void(std::declval<const Config&>()->get_utility()))>
    : public OpenDDS::Security::SecurityPluginInst {
 protected:
  using Utility = typename std::decay<decltype(std::declval<const Config&>()->get_utility())>::type;
  explicit WithUtility(const Config& builtin) : builtin_(builtin) {}
  Utility create_utility() { return builtin_->get_utility(); }

 private:
  Config builtin_;
};

// What both plugins know. OpenDDS calls them from several threads.
struct Known {
  struct Peer {
    std::string question;  // what validate_remote_identity was asked
    int32_t handshake = 0;
  };

  std::mutex mutex;
  Handles handles;
  Refusals refusals;
  Permissions permissions;
  std::map<int32_t, Peer> peers;  // by their identities

  // The shim's handle for a number of OpenDDS; 0 for one that is not known.
  int64_t handle(int32_t number) {
    const std::lock_guard<std::mutex> guard(mutex);
    return handles.handle(number);
  }
  int32_t number(int64_t handle) {
    const std::lock_guard<std::mutex> guard(mutex);
    return handles.number(handle);
  }
  int64_t governing(int32_t permissions) {
    const std::lock_guard<std::mutex> guard(mutex);
    return handles.handle(this->permissions.governing(permissions));
  }

  // The peer authenticated and was refused: it is not let in again at once.
  void refuse_peer(int32_t identity, const std::string& why) {
    const std::lock_guard<std::mutex> guard(mutex);
    const auto found = peers.find(identity);
    if (found != peers.end()) refusals.add(found->second.question, why, now());
  }

  bool is_refused(const std::string& question, std::string& why) {
    const std::lock_guard<std::mutex> guard(mutex);
    return refusals.known(question, now(), why);
  }
  void refuse(std::string question, const std::string& why) {
    const std::lock_guard<std::mutex> guard(mutex);
    refusals.add(std::move(question), why, now());
  }

  static int64_t now() {
    timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec;
  }
};

inline void tell(SecurityException& exception, const std::string& why, int32_t code = -1) {
  exception.message = why.c_str();
  exception.code = code;
  exception.minor_code = 0;
}

// What `work` returns; `refused`, if it has no memory: no exception may reach OpenDDS.
template <typename Result, typename Work>
Result guarded(SecurityException& exception, Result refused, Work work) noexcept {
  try {
    return work();
  } catch (...) {
    try {
      tell(exception, "pqsec: out of memory");
    } catch (...) {
    }
    return refused;
  }
}

// Asks the shim, and tells the stack why if the answer is no.
template <typename Signature, typename Table, typename... Arguments>
auto ask(SecurityException& exception, Table* table, agent::function function,
         Arguments... arguments)
    -> decltype(Function<Signature>::call(table, function, std::declval<Reason&>(), arguments...)) {
  Reason why;
  const auto result = Function<Signature>::call(table, function, why, arguments...);
  if (why.get()->message != nullptr) tell(exception, why.text(), why.code());
  return result;
}

// The plugins; nullptr without memory.
security::Authentication* make_authentication(const std::shared_ptr<Known>& known);
security::AccessControl* make_access_control(const std::shared_ptr<Known>& known);

}  // namespace pqsec

#endif
