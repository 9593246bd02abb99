// Fast DDS's values to those of the shim and back, and the shim's calls to the agent.

#ifndef PQSEC_AGENT_HPP
#define PQSEC_AGENT_HPP

#include <pthread.h>
#include <sys/types.h>

#include <cstdbool>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "stack.hpp"

#define PQSEC_EXPORT extern "C" __attribute__((visibility("default")))

#pragma GCC visibility push(hidden)
namespace agent {  // the shim, in C; the names in its headers are also some of Fast DDS's
extern "C" {
#include "link.h"
}
}  // namespace agent

namespace pqsec {

using agent::handle_t;
using rtps::DataHolder;
using rtps::GUID_t;
using rtps::PropertyPolicy;
using rtps::security::Handle;
using rtps::security::SecurityException;
using rtps::security::Strings;

// The shim only reads it.
inline char* text(const std::string& value) { return const_cast<char*>(value.c_str()); }

inline bool begins(const std::string& value, const std::string& prefix) {
  return value.compare(0, prefix.size(), prefix) == 0;
}

// A token of Fast DDS, for the shim to read while it stays as it is.
class Lent {
 public:
  explicit Lent(const DataHolder& from) {
    for (const auto& each : from.properties())
      properties_.push_back({text(each.name()), text(each.value()), 1});
    for (const auto& each : from.binary_properties()) {
      const auto size = static_cast<uint32_t>(each.value().size());
      binary_.push_back({text(each.name()), {size, size, const_cast<uint8_t*>(each.value().data())}, 1});
    }
    const auto few = static_cast<uint32_t>(properties_.size());
    const auto more = static_cast<uint32_t>(binary_.size());
    token_ = {text(from.class_id()), {few, few, properties_.data()}, {more, more, binary_.data()}};
  }
  Lent(const Lent&) = delete;
  Lent& operator=(const Lent&) = delete;
  const agent::token* get() const { return &token_; }

 private:
  std::vector<agent::property> properties_;
  std::vector<agent::binary_property> binary_;
  agent::token token_;
};

// A token that the agent gives.
class Given {
 public:
  Given() = default;
  ~Given() { agent::free_token(&token_); }
  Given(const Given&) = delete;
  Given& operator=(const Given&) = delete;
  agent::token* get() { return &token_; }

  DataHolder holder() const {
    DataHolder made;
    made.class_id(token_.class_id != nullptr ? token_.class_id : "");
    for (uint32_t i = 0; i < token_.properties.length; i++) {
      const auto& from = token_.properties.buffer[i];
      rtps::Property each;
      each.name(std::string(from.name));
      each.value(std::string(from.value));
      each.propagate(true);
      made.properties().push_back(std::move(each));
    }
    for (uint32_t i = 0; i < token_.binary.length; i++) {
      const auto& from = token_.binary.buffer[i];
      rtps::BinaryProperty each;
      each.name(std::string(from.name));
      each.value(std::vector<uint8_t>(from.value.buffer, from.value.buffer + from.value.length));
      each.propagate(true);
      made.binary_properties().push_back(std::move(each));
    }
    return made;
  }

 private:
  agent::token token_{};
};

// The partitions of an endpoint.
class List {
 public:
  explicit List(const Strings& from) {
    for (const auto& each : from) items_.push_back(text(each));
    const auto count = static_cast<uint32_t>(items_.size());
    list_ = {count, count, items_.data()};
  }
  List(const List&) = delete;
  List& operator=(const List&) = delete;
  const agent::strings* get() const { return &list_; }

 private:
  std::vector<char*> items_;
  agent::strings list_;
};

// A participant's properties for the agent: those of Fast DDS's plugins under the names of
// DDS-Security. The agent refuses security properties that it does not know.
class Settings {
 public:
  explicit Settings(const PropertyPolicy& from);
  Settings(const Settings&) = delete;
  Settings& operator=(const Settings&) = delete;
  const agent::qos* get() const { return &qos_; }

 private:
  std::vector<std::pair<std::string, std::string>> pairs_;
  std::vector<agent::property> items_;
  agent::qos qos_{};
};

// Whether a participant has security properties at all; and what is wrong with the plugins that it
// names, "" if nothing is. Fast DDS runs without a plugin whose name it does not know.
bool is_secured(const PropertyPolicy& policy);
std::string wrong_plugin(const PropertyPolicy& policy);

agent::guid octets_of(const GUID_t& from);
GUID_t guid_of(const agent::guid& from);

// The folder that relative paths of the configuration are relative to; "" if it is unknown.
std::string working_folder();

// Gives the reason to the stack; tell_user also prints it, if the stack does not. Throws nothing.
void tell(SecurityException& exception, const char* why) noexcept;
void tell_user(SecurityException& exception, const char* why) noexcept;

// What `work` returns; `refused`, if it has no memory: no exception may reach the stack.
template <typename Result, typename Work>
Result guarded(SecurityException& exception, Result refused, Work work) noexcept {
  try {
    return work();
  } catch (...) {
    tell(exception, "pqsec: out of memory");
    return refused;
  }
}

// The handles that we give to the stack: the numbers of the agent's handles.
struct Numbered : Handle {
  explicit Numbered(handle_t number) : Handle("pqsec"), number(number) {}
  ~Numbered() override = default;
  bool nil() const override { return false; }
  const handle_t number;
};

inline handle_t number_of(const Handle& handle) {
  return static_cast<const Numbered&>(handle).number;
}

// A connection to the agent.
class Link {
 public:
  explicit Link(const char* plugin) { agent::link_init(&link_, plugin); }
  ~Link() { agent::link_close(&link_); }
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  // False if there is no agent; the user gets the reason.
  bool open(SecurityException& exception);

  // See link.h. -1 if the answer is a refusal; the stack gets the reason.
  template <typename... Arguments>
  int ask(SecurityException& exception, const char* function, const char* kinds,
          Arguments... arguments) const {
    agent::exception why{};
    const int result = agent::ask(&link_, &why, function, kinds, arguments...);
    if (result < 0) tell(exception, why.message);
    free(why.message);
    return result;
  }

  // True if `question(token)` succeeds: `token` is then created, and owned by the stack.
  template <typename Question>
  bool give(DataHolder** token, Question question) const {
    Given given;
    if (question(given.get()) < 0) return false;
    *token = new DataHolder(given.holder());
    return true;
  }

 private:
  mutable agent::link link_;
};

inline bool drop(DataHolder* token) {
  delete token;
  return true;
}

}  // namespace pqsec
#pragma GCC visibility pop

#endif
