// Included by fastdds.cpp: a participant that meets all others of a network. What it says and
// does: see cyclonedds_host.h.
#include <atomic>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <iostream>

constexpr int HOST_DEPTH = 10;  // of ROS 2's default QoS

void tell(const char* what, long count) {
  std::chrono::duration<double> now = Clock::now().time_since_epoch();  // CLOCK_MONOTONIC
  printf("%s %ld %.6f\n", what, count, now.count());
  fflush(stdout);
}

void await_go() {
  std::string line;
  say("ready");
  if (!std::getline(std::cin, line)) _exit(0);
}

struct OfWriter : DataWriterListener {
  void on_publication_matched(DataWriter*, const PublicationMatchedStatus& status) override {
    tell("writer", status.current_count);
  }
};

struct OfReader : DataReaderListener {
  explicit OfReader(std::string name) : own(std::move(name)) {}

  void on_subscription_matched(DataReader*, const SubscriptionMatchedStatus& status) override {
    tell("reader", status.current_count);
  }

  void on_data_available(DataReader* reader) override {
    std::string text;
    for (SampleInfo info; reader->take_next_sample(&text, &info) == 0;)
      if (info.valid_data && text != own) received++;
  }

  std::string own;
  std::atomic<long> received{0};
};

template <typename Qos>
Qos usual(Qos qos) {
  qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
  qos.durability().kind = VOLATILE_DURABILITY_QOS;
  qos.history().kind = KEEP_LAST_HISTORY_QOS;
  qos.history().depth = HOST_DEPTH;
  return qos;
}

void host(DomainParticipant* own, Topic* topic, std::string name) {
  tell("joined", 0);
  OfWriter of_writer;
  OfReader of_reader(name);
  auto publisher = made(own->create_publisher(PUBLISHER_QOS_DEFAULT), "publisher");
  auto subscriber = made(own->create_subscriber(SUBSCRIBER_QOS_DEFAULT), "subscriber");
  auto writer = made(
      publisher->create_datawriter(topic, usual(DATAWRITER_QOS_DEFAULT), &of_writer), "writer");
  made(subscriber->create_datareader(topic, usual(DATAREADER_QOS_DEFAULT), &of_reader), "reader");
  for (std::string line; std::getline(std::cin, line);) {
    const long count = atol(line.c_str());
    for (long i = 0; i < count; i++) {
      writer->write(&name);
      usleep(50000);
    }
    count > 0 ? tell("sent", count) : tell("received", of_reader.received);
  }
}
