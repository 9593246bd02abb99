// OpenDDS's values to those of the shim and back. The types of OpenDDS are parameters, so that the
// tests can have small ones.

#ifndef PQSEC_VALUES_HPP
#define PQSEC_VALUES_HPP

#include <cstring>
#include <string>
#include <vector>

#include "shim.hpp"

namespace pqsec {

// Strings of the IDL mapping, managed and of sequences. The shim only reads them.
inline char* text(const char* value) { return const_cast<char*>(value != nullptr ? value : ""); }
inline char* text(const std::string& value) { return text(value.c_str()); }
template <typename Managed>
auto text(const Managed& value) -> decltype(text(value.in())) {
  return text(value.in());
}

// The IDL mapping copies a const char*, and would own a char*.
inline const char* copied(const char* value) { return text(value); }

template <typename Octets>
agent::octets octets(const Octets& from) {
  const auto size = static_cast<uint32_t>(from.length());
  return {size, size, size != 0 ? const_cast<uint8_t*>(from.get_buffer()) : nullptr};
}

// Properties, which must stay as they are while the shim reads them.
class Properties {
 public:
  template <typename Texts, typename Binary>
  Properties(const Texts& texts, const Binary& binary) {
    for (uint32_t i = 0; i < texts.length(); i++)
      texts_.push_back({text(texts[i].name), text(texts[i].value), texts[i].propagate});
    for (uint32_t i = 0; i < binary.length(); i++)
      binary_.push_back({text(binary[i].name), octets(binary[i].value), binary[i].propagate});
  }
  Properties(const Properties&) = delete;
  Properties& operator=(const Properties&) = delete;
  agent::properties texts() {
    const auto count = static_cast<uint32_t>(texts_.size());
    return {count, count, texts_.data()};
  }
  agent::binary_properties binary() {
    const auto count = static_cast<uint32_t>(binary_.size());
    return {count, count, binary_.data()};
  }

 private:
  std::vector<agent::property> texts_;
  std::vector<agent::binary_property> binary_;
};

// A token of OpenDDS, for the shim to read.
class Lent {
 public:
  template <typename Token>
  explicit Lent(const Token& from) : properties_(from.properties, from.binary_properties) {
    token_ = {text(from.class_id), properties_.texts(), properties_.binary()};
  }
  const agent::token* get() const { return &token_; }

  // All of it: two tokens with the same octets are the same.
  std::string all_octets() const {
    std::string made;
    add(made, token_.class_id, strlen(token_.class_id));
    for (uint32_t i = 0; i < token_.properties.length; i++) {
      const auto& each = token_.properties.buffer[i];
      add(made, each.name, strlen(each.name));
      add(made, each.value, strlen(each.value));
    }
    made += '\n';
    for (uint32_t i = 0; i < token_.binary.length; i++) {
      const auto& each = token_.binary.buffer[i];
      add(made, each.name, strlen(each.name));
      add(made, each.value.buffer, each.value.length);
    }
    return made;
  }

 private:
  static void add(std::string& made, const void* octets, size_t size) {
    made += std::to_string(size) + ":";
    if (size != 0) made.append(static_cast<const char*>(octets), size);
  }

  Properties properties_;
  agent::token token_;
};

// A token that the shim gives.
class Given {
 public:
  Given() = default;
  ~Given() { agent::free_token(&token_); }
  Given(const Given&) = delete;
  Given& operator=(const Given&) = delete;
  agent::token* get() { return &token_; }

  template <typename Token>
  void copy_to(Token& to) const {
    to.class_id = copied(token_.class_id);
    to.properties.length(token_.properties.length);
    for (uint32_t i = 0; i < token_.properties.length; i++) {
      const auto& each = token_.properties.buffer[i];
      to.properties[i].name = copied(each.name);
      to.properties[i].value = copied(each.value);
      to.properties[i].propagate = each.propagate != 0;
    }
    to.binary_properties.length(token_.binary.length);
    for (uint32_t i = 0; i < token_.binary.length; i++) {
      const auto& each = token_.binary.buffer[i];
      auto& made = to.binary_properties[i];
      made.name = copied(each.name);
      made.value.length(each.value.length);
      if (each.value.length != 0)
        memcpy(made.value.get_buffer(), each.value.buffer, each.value.length);
      made.propagate = each.propagate != 0;
    }
  }

 private:
  agent::token token_{};
};

// The properties of a participant.
class Settings {
 public:
  template <typename Policy>
  explicit Settings(const Policy& from) : properties_(from.value, from.binary_value) {
    qos_.properties = properties_.texts();
    qos_.binary = properties_.binary();
  }
  const agent::qos* get() const { return &qos_; }

 private:
  Properties properties_;
  agent::qos qos_{};
};

// Partitions.
class List {
 public:
  template <typename Strings>
  explicit List(const Strings& from) {
    for (uint32_t i = 0; i < from.length(); i++) items_.push_back(text(from[i]));
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

class Tags {
 public:
  template <typename Sequence>
  explicit Tags(const Sequence& from) {
    for (uint32_t i = 0; i < from.length(); i++)
      items_.push_back({text(from[i].name), text(from[i].value)});
    const auto count = static_cast<uint32_t>(items_.size());
    tags_ = {count, count, items_.data()};
  }
  Tags(const Tags&) = delete;
  Tags& operator=(const Tags&) = delete;
  const agent::tags* get() const { return &tags_; }

 private:
  std::vector<agent::tag> items_;
  agent::tags tags_;
};

// OpenDDS leaves a letter out of the name of one of its own topics (DDS-Security 1.1, table 10).
inline const char* standard_topic(const char* name) {
  return strcmp(name, "DCPSParticipantSecure") == 0 ? "DCPSParticipantsSecure" : name;
}

}  // namespace pqsec

#endif
