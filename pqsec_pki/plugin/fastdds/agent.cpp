// See agent.hpp.

#include "agent.hpp"

#include <unistd.h>

namespace pqsec {
namespace {

struct Plugin {
  const char* property;
  const char* name;
};

// The only names that Fast DDS 2.x and 3.x know.
constexpr Plugin PLUGINS[] = {
    {"dds.sec.auth.plugin", "builtin.PKI-DH"},
    {"dds.sec.access.plugin", "builtin.Access-Permissions"},
    {"dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC"},
};

struct Prefix {
  const char* theirs;
  const char* standard;
};

constexpr Prefix PREFIXES[] = {
    {"dds.sec.auth.builtin.PKI-DH.", "dds.sec.auth."},
    {"dds.sec.access.builtin.Access-Permissions.", "dds.sec.access."},
};

constexpr char SECURITY[] = "dds.sec.", LOGGING[] = "dds.sec.log.";

// How often Fast DDS sends a handshake message again, which it decides itself.
constexpr const char* RESENDING[] = {
    "dds.sec.auth.builtin.PKI-DH.max_handshake_requests",
    "dds.sec.auth.builtin.PKI-DH.initial_handshake_resend_period",
    "dds.sec.auth.builtin.PKI-DH.handshake_resend_period_gain",
};

bool is_of_the_stack(const std::string& name) {
  for (const auto& each : PLUGINS)
    if (name == each.property) return true;
  for (const auto* each : RESENDING)
    if (name == each) return true;
  return begins(name, LOGGING);
}

std::string standard_name(const std::string& name) {
  for (const auto& each : PREFIXES)
    if (begins(name, each.theirs)) return each.standard + name.substr(strlen(each.theirs));
  return name;
}

}  // namespace

Settings::Settings(const PropertyPolicy& from) {
  for (const auto& each : from.properties())
    if (begins(each.name(), SECURITY) && !is_of_the_stack(each.name()))
      pairs_.emplace_back(standard_name(each.name()), each.value());
  for (const auto& each : pairs_) items_.push_back({text(each.first), text(each.second), 0});
  const auto count = static_cast<uint32_t>(items_.size());
  qos_.properties = {count, count, items_.data()};
}

bool is_secured(const PropertyPolicy& policy) {
  for (const auto& each : policy.properties())
    if (begins(each.name(), SECURITY)) return true;
  return false;
}

std::string wrong_plugin(const PropertyPolicy& policy) {
  for (const auto& plugin : PLUGINS) {
    bool found = false;
    for (const auto& each : policy.properties()) {
      if (each.name() != plugin.property) continue;
      if (each.value() != plugin.name)
        return std::string("pqsec: ") + plugin.property + " must be " + plugin.name +
               ": Fast DDS knows no other, and runs without security";
      found = true;
    }
    if (!found) return std::string("pqsec: ") + plugin.property + " is missing: set it to " + plugin.name;
  }
  return "";
}

agent::guid octets_of(const GUID_t& from) {
  agent::guid made;
  memcpy(made.octets, from.guidPrefix.value, sizeof from.guidPrefix.value);
  memcpy(made.octets + sizeof from.guidPrefix.value, from.entityId.value,
         sizeof from.entityId.value);
  return made;
}

GUID_t guid_of(const agent::guid& from) {
  GUID_t made;
  memcpy(made.guidPrefix.value, from.octets, sizeof made.guidPrefix.value);
  memcpy(made.entityId.value, from.octets + sizeof made.guidPrefix.value,
         sizeof made.entityId.value);
  return made;
}

std::string working_folder() {
  char path[4096];
  return getcwd(path, sizeof path) != nullptr ? path : "";
}

void tell(SecurityException& exception, const char* why) noexcept {
  try {
    exception = SecurityException(std::string(why != nullptr ? why : "pqsec: refused"));
  } catch (...) {
    // Without memory for the reason, the refusal stands without it.
  }
}

void tell_user(SecurityException& exception, const char* why) noexcept {
  fprintf(stderr, "%s\n", why);
  tell(exception, why);
}

bool Link::open(SecurityException& exception) {
  agent::exception why{};
  const bool open = agent::link_open(&link_, &why);
  if (!open) tell_user(exception, why.message != nullptr ? why.message : "pqsec: no agent");
  free(why.message);
  return open;
}

}  // namespace pqsec
