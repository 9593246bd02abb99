// As much of OpenDDS as pqsec_participant.h uses; #include <dds/DdsDcpsInfrastructureC.h>.

#include <string>
#include <vector>

namespace DDS {

struct Property_t {
    std::string name, value;
    bool propagate;
};

struct PropertySeq : private std::vector<Property_t> {
    using std::vector<Property_t>::operator[];
    unsigned int length() const { return static_cast<unsigned int>(size()); }
    void length(unsigned int wanted) { resize(wanted); }
};

struct DomainParticipantQos {
    struct { PropertySeq value; } property;
};

}  // namespace DDS
