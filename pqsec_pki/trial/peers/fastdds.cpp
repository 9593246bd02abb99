// A participant of Fast DDS, 2.x or 3.x, that sends or receives one text, or meets many others.
//
// usage: peer send|receive DOMAIN TOPIC TEXT SECONDS
//        peer host DOMAIN TOPIC TEXT SECONDS          see cyclonedds_host.h
//
// Its configuration is the default profile of a participant in the file that
// FASTRTPS_DEFAULT_PROFILES_FILE (2.x) or FASTDDS_DEFAULT_PROFILES_FILE (3.x) names. What it says
// on stdout, and when it ends: see cyclonedds.c.
#include <sys/prctl.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <string>

#if __has_include(<fastdds/config.hpp>)
#define FASTDDS_3 1
#endif

using namespace eprosima::fastdds::dds;
using Clock = std::chrono::steady_clock;
#if FASTDDS_3
using eprosima::fastdds::rtps::InstanceHandle_t;
using eprosima::fastdds::rtps::SerializedPayload_t;
#else
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
#endif

constexpr uint32_t LARGEST = 1024;  // bytes of a sample

// CDR, little endian: an encapsulation header, the length with its NUL, the text.
bool write_text(const std::string& text, SerializedPayload_t& payload) {
  const unsigned char header[] = {0, 1, 0, 0};
  const uint32_t size = text.size() + 1;
  if (size + 8 > payload.max_size) return false;
  memcpy(payload.data, header, 4);
  memcpy(payload.data + 4, &size, 4);
  memcpy(payload.data + 8, text.c_str(), size);
  payload.encapsulation = CDR_LE;
  payload.length = 8 + size;
  return true;
}

bool read_text(const SerializedPayload_t& payload, std::string& text) {
  uint32_t size = 0;
  if (payload.length < 8) return false;
  memcpy(&size, payload.data + 4, 4);
  if (size == 0 || size > payload.length - 8) return false;
  text.assign(reinterpret_cast<const char*>(payload.data) + 8, size - 1);
  return true;
}

struct Sample : TopicDataType {
#if FASTDDS_3
  Sample() {
    set_name("pqsec::Sample");
    max_serialized_type_size = LARGEST;
    is_compute_key_provided = false;
  }
  bool serialize(const void* const text, SerializedPayload_t& payload,
                 DataRepresentationId_t) override {
    return write_text(*static_cast<const std::string*>(text), payload);
  }
  bool deserialize(SerializedPayload_t& payload, void* text) override {
    return read_text(payload, *static_cast<std::string*>(text));
  }
  uint32_t calculate_serialized_size(const void* const, DataRepresentationId_t) override {
    return LARGEST;
  }
  void* create_data() override { return new std::string; }
  void delete_data(void* text) override { delete static_cast<std::string*>(text); }
  bool compute_key(SerializedPayload_t&, InstanceHandle_t&, bool) override { return false; }
  bool compute_key(const void* const, InstanceHandle_t&, bool) override { return false; }
#else
  Sample() {
    setName("pqsec::Sample");
    m_typeSize = LARGEST;
    m_isGetKeyDefined = false;
  }
  bool serialize(void* text, SerializedPayload_t* payload) override {
    return write_text(*static_cast<std::string*>(text), *payload);
  }
  bool deserialize(SerializedPayload_t* payload, void* text) override {
    return read_text(*payload, *static_cast<std::string*>(text));
  }
  std::function<uint32_t()> getSerializedSizeProvider(void*) override {
    return [] { return LARGEST; };
  }
  void* createData() override { return new std::string; }
  void deleteData(void* text) override { delete static_cast<std::string*>(text); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
#endif
};

void say(const std::string& line) {
  puts(line.c_str());
  fflush(stdout);
}

[[noreturn]] void end(int code) {
  Log::Flush();
  fflush(stdout);
  _exit(code);  // what a stack does as it ends is no matter here
}

// The entity, or the end: the stack refused to make it.
template <typename Entity>
Entity* made(Entity* entity, const char* what) {
  if (entity) return entity;
  Log::Flush();
  say(std::string("refused ") + what + ": the stack made none");
  end(3);
}

void send_until(DataWriter* writer, std::string text, Clock::time_point over) {
  say("created");
  for (bool matched = false; Clock::now() < over; usleep(50000)) {
    PublicationMatchedStatus status;
    writer->get_publication_matched_status(status);
    if (status.current_count > 0 && !matched) {
      matched = true;
      say("matched");
    }
    writer->write(&text);
  }
}

void receive_until(DataReader* reader, Clock::time_point over) {
  say("created");
  std::string text;
  for (SampleInfo info; Clock::now() < over; usleep(50000)) {
    if (reader->take_next_sample(&text, &info) == 0 && info.valid_data) {
      say("received " + text);
      return;
    }
  }
}

DomainParticipant* participant(int domain) {
  auto factory = DomainParticipantFactory::get_instance();
  factory->load_profiles();
  return factory->create_participant(domain, factory->get_default_participant_qos());
}

template <typename Qos>
Qos lasting(Qos qos) {
  qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
  qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
  return qos;
}

#include "fastdds_host.hpp"

int main(int count, char** words) {
  if (count != 6) return 2;
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // nobody is left to end it
  auto over = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                 std::chrono::duration<double>(atof(words[5])));
  Log::SetVerbosity(Log::Kind::Warning);
  if (strcmp(words[1], "host") == 0) await_go();
  auto own = made(participant(atoi(words[2])), "participant");
  say("joined");
  TypeSupport type(new Sample);
  type.register_type(own);
  auto topic = made(own->create_topic(words[3], "pqsec::Sample", TOPIC_QOS_DEFAULT), "topic");
  if (strcmp(words[1], "host") == 0) {
    host(own, topic, words[4]);
  } else if (strcmp(words[1], "send") == 0) {
    auto publisher = made(own->create_publisher(PUBLISHER_QOS_DEFAULT), "publisher");
    auto writer = publisher->create_datawriter(topic, lasting(DATAWRITER_QOS_DEFAULT));
    send_until(made(writer, "writer"), words[4], over);
  } else {
    auto subscriber = made(own->create_subscriber(SUBSCRIBER_QOS_DEFAULT), "subscriber");
    auto reader = subscriber->create_datareader(topic, lasting(DATAREADER_QOS_DEFAULT));
    receive_until(made(reader, "reader"), over);
  }
  end(0);
}
