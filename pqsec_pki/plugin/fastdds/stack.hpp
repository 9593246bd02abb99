// Fast DDS's plugin interface: 2.x from its installed headers; 3.x installs none for it.
//
// PQSEC_FASTDDS is 2 or 3. PQSEC_BY_PROPERTIES is 1 where participants are described by a
// PropertyPolicy alone, PQSEC_MORE_FUNCTIONS where Authentication has two more functions, since the
// fix of CVE-2025-67108, PQSEC_DERIVED where what is known of an endpoint derives from a public
// structure (3.2). All come from the library's symbols.

#ifndef PQSEC_STACK_HPP
#define PQSEC_STACK_HPP

#if PQSEC_FASTDDS == 2
#include <fastdds/rtps/attributes/RTPSParticipantAttributes.h>
#include <fastdds/rtps/builtin/data/ReaderProxyData.h>
#include <fastdds/rtps/builtin/data/WriterProxyData.h>
#include <fastdds/rtps/security/accesscontrol/AccessControl.h>
#include <fastdds/rtps/security/accesscontrol/EndpointSecurityAttributes.h>
#include <fastdds/rtps/security/accesscontrol/ParticipantSecurityAttributes.h>
#include <fastdds/rtps/security/authentication/Authentication.h>
#define PQSEC_RTPS eprosima::fastrtps::rtps
#else
#include "interface3.hpp"
#define PQSEC_RTPS eprosima::fastdds::rtps
#endif

#include <string>
#include <vector>

namespace rtps = PQSEC_RTPS;

namespace PQSEC_RTPS::security {

#if PQSEC_BY_PROPERTIES
using Configuration = PropertyPolicy;
inline const PropertyPolicy& policy_of(const PropertyPolicy& from) { return from; }
#else
using Configuration = RTPSParticipantAttributes;
inline const PropertyPolicy& policy_of(const RTPSParticipantAttributes& from) {
  return from.properties;
}
#endif

using Strings = std::vector<std::string>;

// What access control asks of an endpoint that was discovered. probe.cpp proves that this is read where
// the library writes it.
struct Discovered {
#if PQSEC_FASTDDS == 2
  explicit Discovered(const WriterProxyData& from)
      : topic(from.topicName().to_string()), partitions(from.m_qos.m_partition.getNames()) {}
  explicit Discovered(const ReaderProxyData& from)
      : topic(from.topicName().to_string()), partitions(from.m_qos.m_partition.getNames()) {}
#else
  explicit Discovered(const WriterProxyData& from)
      : Discovered(described<PublicationBuiltinTopicData>(from)) {}
  explicit Discovered(const ReaderProxyData& from)
      : Discovered(described<SubscriptionBuiltinTopicData>(from)) {}
#endif
  std::string topic;
  Strings partitions;

#if PQSEC_FASTDDS != 2
 private:
  explicit Discovered(const PublicationBuiltinTopicData& from)
      : topic(from.topic_name.to_string()), partitions(from.partition.getNames()) {}
  explicit Discovered(const SubscriptionBuiltinTopicData& from)
      : topic(from.topic_name.to_string()), partitions(from.partition.getNames()) {}

#if PQSEC_DERIVED
  template <typename Public, typename Private>
  static const Public& described(const Private& from) {
    return from;
  }
#else
  template <typename Public, typename Private>
  static Public described(const Private& from) {
    Public data;
    from_proxy_to_builtin(from, data);
    return data;
  }
#endif
#endif
};

}  // namespace PQSEC_RTPS::security

#endif
