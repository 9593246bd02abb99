// Authenticated peers in a session: until when their credentials hold, and how they are disconnected.
//
// Fast DDS 2.9 and 3.1 have no listener for revocation and expiry. But whenever a participant
// announces itself again, its thread of events comes by here, where it also drops peers that it has
// not heard of for too long. It also drops peers that the agent finds revoked or expired.
// A thread of our own asks the agent: a participant whose thread of events waited for a busy agent
// would not announce itself, and its peers would drop it.

#ifndef PQSEC_SESSIONS_HPP
#define PQSEC_SESSIONS_HPP

#include <atomic>
#include <mutex>
#include <set>

#include "agent.hpp"

#pragma GCC visibility push(hidden)
namespace agent {
extern "C" {
#include "watch.h"
}
}  // namespace agent

namespace pqsec {

constexpr int64_t FOR_EVER = INT64_MAX;

// A participant, ours or a peer.
struct Identity : Numbered {
  explicit Identity(handle_t number, const agent::guid& guid = {}) : Numbered(number), guid(guid) {}

  // `when` in seconds since 1970; 0 for never.
  void lasts_until(int64_t when) const {
    if (when != 0 && when < end) end = when;
  }

  const agent::guid guid;
  std::atomic<handle_t> handshake{0};  // the latest with that peer
  mutable std::atomic<int64_t> end{FOR_EVER};
};

// The peers of one participant.
class Sessions {
 public:
  explicit Sessions(const Link& link) : link_(link) { agent::watch_init(&watch_, this); }
  ~Sessions();
  Sessions(const Sessions&) = delete;
  Sessions& operator=(const Sessions&) = delete;

  void add(const Identity* peer);
  void remove(const Identity* peer);
  void lasts_until(handle_t peer, int64_t when);
  // The agent is to be asked who is revoked.
  void has_list();
  // This participant is the one whose object of discovery is being made in this thread, if any is.
  void is_being_made();

  // Calls `drop(guid)` for each peer that must go, once.
  template <typename Drop>
  void lost(Drop drop) {
    for (const auto& each : expired()) drop(each);
    for (const auto& each : revoked()) drop(each);
  }

  // Those of that object of discovery; nullptr if there are none.
  static Sessions* of(const void* discovery);

 private:
  std::vector<agent::guid> expired();
  std::vector<agent::guid> revoked();
  void find_revoked();

  const Link& link_;
  std::mutex mutex_;
  std::set<const Identity*> peers_;
  std::set<handle_t> revoked_;  // those that the agent found, until they are dropped
  const void* discovery_ = nullptr;
  agent::watch watch_;
};

}  // namespace pqsec
#pragma GCC visibility pop

#endif
