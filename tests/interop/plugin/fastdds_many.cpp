// Appended to the peer for trials, whose main becomes `peer_main`.
//
// usage: many meet COUNT TOPIC SECONDS    that many participants in one process meet each other
//        many cycle COUNT TOPIC SECONDS   one participant after the other is made and deleted
//
// It says `all matched` or `cycled`, with the number of open files and threads at the end.

#include <filesystem>
#include <memory>
#include <vector>

namespace {

struct One {
  explicit One(const char* name) : own(made(participant(5), "participant")) {
    type.register_type(own);
    auto topic = made(own->create_topic(name, "pqsec::Sample", TOPIC_QOS_DEFAULT), "topic");
    auto publisher = made(own->create_publisher(PUBLISHER_QOS_DEFAULT), "publisher");
    auto subscriber = made(own->create_subscriber(SUBSCRIBER_QOS_DEFAULT), "subscriber");
    writer = made(publisher->create_datawriter(topic, lasting(DATAWRITER_QOS_DEFAULT)), "writer");
    reader = made(subscriber->create_datareader(topic, lasting(DATAREADER_QOS_DEFAULT)), "reader");
  }

  ~One() {
    own->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(own);
  }

  int matched() {
    PublicationMatchedStatus status;
    writer->get_publication_matched_status(status);
    return status.current_count;
  }

  DomainParticipant* own;
  TypeSupport type{new Sample};
  DataWriter* writer;
  DataReader* reader;
};

long entries(const char* folder) {
  return std::distance(std::filesystem::directory_iterator(folder), {});
}

bool all_matched(std::vector<std::unique_ptr<One>>& all) {
  for (auto& each : all)
    if (each->matched() != static_cast<int>(all.size())) return false;
  return true;
}

}  // namespace

int main(int count, char** words) {
  if (count != 5) return 2;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  const int many = atoi(words[2]);
  auto over = Clock::now() + std::chrono::seconds(atoi(words[4]));
  Log::SetVerbosity(Log::Kind::Error);
  if (strcmp(words[1], "meet") == 0) {
    std::vector<std::unique_ptr<One>> all;
    for (int i = 0; i < many; i++) all.push_back(std::make_unique<One>(words[3]));
    while (!all_matched(all) && Clock::now() < over) usleep(50000);
    say(all_matched(all) ? "all matched" : "not matched");
  } else {
    { One first(words[3]); }
    const long before = entries("/proc/self/fd") + entries("/proc/self/task");
    for (int i = 0; i < many; i++) One again(words[3]);
    say("cycled, more than before: " +
        std::to_string(entries("/proc/self/fd") + entries("/proc/self/task") - before));
  }
  Log::Flush();
  return 0;
}
