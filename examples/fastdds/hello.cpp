// A small program for Fast DDS 2.x and 3.x. Of security it knows nothing: that comes with the
// default profile, from the file that the environment names.
//
//   hello send        sends "hello" until somebody has it
//   hello receive     prints it; both give up after five seconds, with exit code 1

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <functional>
#include <thread>

using namespace eprosima::fastdds::dds;

#if __has_include(<fastdds/config.hpp>)  // 3.x
#define FASTDDS_3 1
using eprosima::fastdds::rtps::InstanceHandle_t;
using eprosima::fastdds::rtps::SerializedPayload_t;
#else
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
#endif

const int DOMAIN_ID = 78;

struct Word
{
    char text[16];
};

// How a Word stands in a message: a header that says CDR, little endian, and sixteen octets.
class WordType : public TopicDataType
{
public:
#if FASTDDS_3
    WordType()
    {
        set_name("Word");
        max_serialized_type_size = SIZE;
        is_compute_key_provided = false;
    }

    bool serialize(const void* data, SerializedPayload_t& payload, DataRepresentationId_t) override
    {
        return write(data, payload);
    }
    bool deserialize(SerializedPayload_t& payload, void* data) override
    {
        return read(payload, data);
    }
    uint32_t calculate_serialized_size(const void*, DataRepresentationId_t) override
    {
        return SIZE;
    }
    void* create_data() override { return new Word; }
    void delete_data(void* data) override { delete static_cast<Word*>(data); }
    bool compute_key(SerializedPayload_t&, InstanceHandle_t&, bool) override { return false; }
    bool compute_key(const void*, InstanceHandle_t&, bool) override { return false; }
#else
    WordType()
    {
        setName("Word");
        m_typeSize = SIZE;
    }

    bool serialize(void* data, SerializedPayload_t* payload) override
    {
        return write(data, *payload);
    }
    bool deserialize(SerializedPayload_t* payload, void* data) override
    {
        return read(*payload, data);
    }
    std::function<uint32_t()> getSerializedSizeProvider(void*) override
    {
        return [] { return SIZE; };
    }
    void* createData() override { return new Word; }
    void deleteData(void* data) override { delete static_cast<Word*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
#endif

private:
    static constexpr uint32_t SIZE = 4 + sizeof(Word);

    static bool write(const void* data, SerializedPayload_t& payload)
    {
        const unsigned char header[] = {0, 1, 0, 0};
        std::memcpy(payload.data, header, sizeof header);
        std::memcpy(payload.data + sizeof header, data, sizeof(Word));
        payload.encapsulation = CDR_LE;
        payload.length = SIZE;
        return true;
    }

    static bool read(const SerializedPayload_t& payload, void* data)
    {
        if (payload.length < SIZE) {
            return false;
        }
        std::memcpy(data, payload.data + SIZE - sizeof(Word), sizeof(Word));
        return true;
    }
};

bool within_five_seconds(const std::function<bool()>& happened)
{
    for (int tries = 0; tries < 100; ++tries) {
        if (happened()) {
            return true;
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    return false;
}

bool send(DomainParticipant* participant, Topic* topic)
{
    auto publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    DataWriterQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    auto writer = publisher->create_datawriter(topic, qos);
    Word word{"hello"};
    // The overload that gives a return code, 0 if all is well, in 2.x too.
    return writer && writer->write(&word, InstanceHandle_t()) == 0 && within_five_seconds([&] {
        PublicationMatchedStatus matched;
        writer->get_publication_matched_status(matched);
        return matched.total_count > 0 && matched.current_count == 0;  // it came, and went
    });
}

bool receive(DomainParticipant* participant, Topic* topic)
{
    auto subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    DataReaderQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    auto reader = subscriber->create_datareader(topic, qos);
    Word word{};
    SampleInfo info;
    const bool there = reader && within_five_seconds([&] {
        return reader->take_next_sample(&word, &info) == 0 && info.valid_data;
    });
    if (there) {
        std::printf("received %.16s\n", word.text);
    }
    return there;
}

int main(int, char** arguments)
{
    auto factory = DomainParticipantFactory::get_instance();
    auto participant = factory->create_participant(DOMAIN_ID, PARTICIPANT_QOS_DEFAULT);
    if (!participant) {
        return 1;
    }
    TypeSupport type(new WordType);
    type.register_type(participant);
    auto topic = participant->create_topic("words", "Word", TOPIC_QOS_DEFAULT);
    const bool sends = arguments[1] && std::strcmp(arguments[1], "send") == 0;
    const bool done = topic && (sends ? send(participant, topic) : receive(participant, topic));
    participant->delete_contained_entities();
    factory->delete_participant(participant);
    return done ? 0 : 1;
}
