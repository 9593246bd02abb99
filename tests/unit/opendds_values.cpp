// What pqsec's adapter for OpenDDS does without OpenDDS: its types are small ones of this file.

#include <cstdio>

#include "handles.hpp"
#include "values.hpp"

namespace agent {
extern "C" {
#include "wire.h"
}
}  // namespace agent

namespace {

// As much of the IDL mapping as is used: sequences, and strings that manage their memory.
template <typename Item>
class Sequence {
 public:
  uint32_t length() const { return static_cast<uint32_t>(items_.size()); }
  void length(uint32_t wanted) { items_.resize(wanted); }
  Item& operator[](uint32_t i) { return items_[i]; }
  const Item& operator[](uint32_t i) const { return items_[i]; }
  Item* get_buffer() { return items_.data(); }
  const Item* get_buffer() const { return items_.data(); }

 private:
  std::vector<Item> items_;
};

class Managed {
 public:
  Managed& operator=(const char* value) { value_ = value; return *this; }
  Managed& operator=(char*) = delete;  // it would own that
  const char* in() const { return value_.c_str(); }

 private:
  std::string value_;
};

struct Property { Managed name, value; bool propagate = false; };
struct Binary { Managed name; Sequence<uint8_t> value; bool propagate = false; };
struct Token { Managed class_id; Sequence<Property> properties; Sequence<Binary> binary_properties; };
struct Policy { Sequence<Property> value; Sequence<Binary> binary_value; };

Token token(const char* text, const char* octets, uint32_t size) {
  Token made;
  made.class_id = "DDS:Auth:PKI-DH:1.0";
  made.properties.length(1);
  made.properties[0].name = "c.id";
  made.properties[0].value = text;
  made.properties[0].propagate = true;
  made.binary_properties.length(1);
  made.binary_properties[0].name = "c.dh";
  made.binary_properties[0].value.length(size);
  for (uint32_t i = 0; i < size; i++)
    made.binary_properties[0].value[i] = static_cast<uint8_t>(octets[i]);
  return made;
}

std::string octets_of(const Token& token) { return pqsec::Lent(token).all_octets(); }

// To the agent's octets and back.
void values() {
  const Token from = token("the text", "\0\1\377", 3);
  agent::writer writer{};
  put_token(&writer, pqsec::Lent(from).get());
  agent::reader reader{writer.data, writer.size, false};
  pqsec::Given given;
  get_token(&reader, given.get());
  Token to = token("other", "longer than before", 18);
  given.copy_to(to);
  printf("same %d left %zu\n", octets_of(from) == octets_of(to), reader.left);
  printf("class %s text %s size %u last %u\n", to.class_id.in(), to.properties[0].value.in(),
         to.binary_properties[0].value.length(), to.binary_properties[0].value[2]);
  free(writer.data);

  Token empty;
  pqsec::Given nothing;
  to = from;
  nothing.copy_to(to);
  printf("empty %d\n", octets_of(to) == octets_of(empty));

  // Where one name or value ends and the next begins counts.
  Token one = token("ab", "c", 1), other = token("a", "bc", 2);
  printf("different %d\n", octets_of(one) != octets_of(other));

  Policy policy;
  policy.value.length(1);
  policy.value[0].name = "dds.sec.auth.identity_ca";
  policy.value[0].value = "file:ca.pem";
  const pqsec::Settings settings(policy);
  printf("setting %s=%s\n", settings.get()->properties.buffer[0].name,
         settings.get()->properties.buffer[0].value);

  Sequence<Managed> names;
  names.length(2);
  names[0] = "floor1";
  const pqsec::List partitions(names);
  printf("partitions %u [%s] [%s]\n", partitions.get()->length, partitions.get()->buffer[0],
         partitions.get()->buffer[1]);

  Sequence<Property> pairs;
  pairs.length(1);
  pairs[0].name = "level";
  pairs[0].value = "high";
  const pqsec::Tags tags(pairs);
  printf("tags %s=%s\n", tags.get()->buffer[0].name, tags.get()->buffer[0].value);
  printf("topics %s %s\n", pqsec::standard_topic("DCPSParticipantSecure"),
         pqsec::standard_topic("Square"));
}

void handles() {
  pqsec::Handles handles;
  const int64_t large = INT64_C(1) << 40, larger = large + (INT64_C(1) << 32);
  const int32_t none = handles.number(0), one = handles.number(large);
  const int32_t other = handles.number(larger), again = handles.number(large);
  printf("numbers %d %d %d again %d\n", none, one, other, again);
  printf("back %d %d unknown %d %d\n", handles.handle(one) == large,
         handles.handle(other) == larger, handles.handle(99) == 0, handles.handle(-1) == 0);
  handles.drop(one);
  handles.drop(0);
  printf("dropped %d found %d left %zu", handles.handle(one) == 0, handles.find(large),
         handles.size());
  printf(" never again %d\n", handles.number(large));
}

void refusals() {
  pqsec::Refusals refusals;
  std::string why;
  printf("known %d", refusals.known("a question", 0, why));
  refusals.add("a question", "a reason", 10);
  printf(" %d %s", refusals.known("a question", 10, why), why.c_str());
  printf(" other %d", refusals.known("another", 10, why));
  printf(" later %d", refusals.known("a question", 10 + pqsec::Refusals::SECONDS - 1, why));
  printf(" over %d\n", refusals.known("a question", 10 + pqsec::Refusals::SECONDS, why));

  const size_t half = pqsec::Refusals::MAX_OCTETS / 2;
  refusals.add("first", "", 20);
  refusals.add(std::string(half, 'a'), "", 20);
  refusals.add(std::string(half, 'b'), "", 20);
  printf("full: first %d last %d\n", refusals.known("first", 20, why),
         refusals.known(std::string(half, 'b'), 20, why));
  refusals.add(std::string(3 * half, 'c'), "", 20);
  printf("too large %d\n", refusals.known(std::string(3 * half, 'c'), 20, why));
}

void permissions() {
  pqsec::Permissions permissions;
  permissions.add_own(1, 11);
  permissions.add_own(2, 12);
  permissions.add_peers(21, 1, 31);
  permissions.add_peers(22, 2, 31);
  printf("governing %d %d %d %d\n", permissions.governing(11), permissions.governing(21),
         permissions.governing(22), permissions.governing(99));
  printf("peer %d %d\n", permissions.peer(21), permissions.peer(11));
  permissions.drop(21);
  printf("dropped %d %d\n", permissions.governing(21), permissions.peer(21));
}

}  // namespace

int main() {
  values();
  handles();
  refusals();
  permissions();
}
