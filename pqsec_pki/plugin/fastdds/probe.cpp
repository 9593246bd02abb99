// Proves that the adapter finds topics and partitions where this library writes them.
//
// The library reads an announcement of an endpoint, as peers send it, into an object of its own. What
// access control asks for must then be what was announced. An adapter with another layout compiles,
// has the right virtual functions and shakes hands, but asks for topics that nobody has.

#include <cstddef>
#include <new>

#include "agent.hpp"

namespace PQSEC_RTPS::security {
namespace {

// DDSI-RTPS 2.3, 9.4.2.11: parameters in PL_CDR_LE, each with its identifier and its length.
constexpr char ANNOUNCED[] =
    "\x00\x03\x00\x00"
    "\x05\x00\x14\x00"  // PID_TOPIC_NAME
    "\x0f\x00\x00\x00" "rt/pqsec_probe\0\0"
    "\x29\x00\x20\x00"  // PID_PARTITION
    "\x02\x00\x00\x00"
    "\x06\x00\x00\x00" "floor\0\0\0"
    "\x0c\x00\x00\x00" "pqsec probe\0"
    "\x01\x00\x00\x00";  // PID_SENTINEL
constexpr uint32_t SIZE = sizeof ANNOUNCED - 1;
static_assert(SIZE == 4 + 24 + 36 + 4);

// Octets for an object of the library, which takes some thousands.
constexpr size_t ROOM = 1 << 16;

#if PQSEC_DERIVED
template <typename Data>
bool read(Data& data, CDRMessage_t& message, NetworkFactory&, int) {
  return data.read_from_cdr_message(&message, c_VendorId_eProsima);
}
#else
template <typename Data>
auto read(Data& data, CDRMessage_t& message, NetworkFactory& network, int)
    -> decltype(data.readFromCDRMessage(&message, network, false)) {
  return data.readFromCDRMessage(&message, network, false);
}

template <typename Data>  // 2.14
auto read(Data& data, CDRMessage_t& message, NetworkFactory& network, long)
    -> decltype(data.readFromCDRMessage(&message, network, false, false)) {
  return data.readFromCDRMessage(&message, network, false, false);
}
#endif

template <typename Data>
bool is_found() {
  std::vector<std::max_align_t> room(ROOM / sizeof(std::max_align_t));
  std::vector<std::max_align_t> unused(ROOM / sizeof(std::max_align_t));
  // Without locators in the announcement, the library does not look at its network.
  auto& network = *reinterpret_cast<NetworkFactory*>(unused.data());
  CDRMessage_t message(SIZE);
  memcpy(message.buffer, ANNOUNCED, SIZE);
  message.length = SIZE;
  auto* data = new (room.data()) Data(1, 1);
  const bool is_read = read(*data, message, network, 0);
  const Discovered found(*data);
  const Strings partitions = {"floor", "pqsec probe"};
  data->~Data();
  return is_read && found.topic == "rt/pqsec_probe" && found.partitions == partitions;
}

}  // namespace
}  // namespace PQSEC_RTPS::security

// Whether the adapter understands the library. The preload library asks at each participant.
PQSEC_EXPORT bool pqsec_probe() noexcept {
  using namespace rtps::security;
  static const bool is_good = [] {
    SecurityException exception{std::string()};
    return pqsec::guarded(exception, false, [] {
      return is_found<rtps::WriterProxyData>() && is_found<rtps::ReaderProxyData>();
    });
  }();
  return is_good;
}
