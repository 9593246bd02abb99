// A participant of Fast DDS by its default profile: says which properties it has, or fails.

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/log/Log.hpp>

#include <cstdio>
#include <unistd.h>

using namespace eprosima::fastdds::dds;

int main()
{
    DomainParticipant* participant =
        DomainParticipantFactory::get_instance()->create_participant(0, PARTICIPANT_QOS_DEFAULT);
    if (participant) {
        for (auto& each : participant->get_qos().properties().properties()) {
            std::printf("%s=%s\n", each.name().c_str(), each.value().c_str());
        }
    }
    std::fflush(stdout);
    Log::Flush();
    _exit(participant ? 0 : 1);  // its own ending waits for its threads
}
