// What is remembered between calls; no type of OpenDDS. The caller holds a lock.

#ifndef PQSEC_HANDLES_HPP
#define PQSEC_HANDLES_HPP

#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <string>
#include <utility>

namespace pqsec {

// The agent's handles have 64 bits, OpenDDS's 32. 0 is none in both.
class Handles {
 public:
  // The same number for the same handle; 0 for 0, or if there is no number left.
  int32_t number(int64_t handle) {
    if (handle == 0) return 0;
    const auto found = numbers_.find(handle);
    if (found != numbers_.end()) return found->second;
    if (last_ == std::numeric_limits<int32_t>::max()) return 0;
    last_++;  // never used twice: what OpenDDS still has of an earlier one fits nothing
    numbers_[handle] = last_;
    handles_[last_] = handle;
    return last_;
  }

  // 0 for a number that is not known.
  int64_t handle(int32_t number) const {
    const auto found = handles_.find(number);
    return found == handles_.end() ? 0 : found->second;
  }

  // 0 for a handle that OpenDDS does not have.
  int32_t find(int64_t handle) const {
    const auto found = numbers_.find(handle);
    return found == numbers_.end() ? 0 : found->second;
  }

  void drop(int32_t number) {
    numbers_.erase(handle(number));
    handles_.erase(number);
  }

  size_t size() const { return handles_.size(); }

 private:
  std::map<int64_t, int32_t> numbers_;
  std::map<int32_t, int64_t> handles_;
  int32_t last_ = 0;
};

// OpenDDS forgets a peer that is refused, finds it again at once, and asks again: hundreds of times
// a second. The same question, in all its octets, gets the same refusal for a while.
class Refusals {
 public:
  enum { SECONDS = 5, MAX_OCTETS = 1 << 22 };

  // Whether it was refused within SECONDS; `now` is in seconds, of a clock that does not go back.
  bool known(const std::string& question, int64_t now, std::string& why) {
    while (!all_.empty() && all_.front().until <= now) drop_first();
    for (const auto& each : all_)
      if (each.question == question) {
        why = each.why;
        return true;
      }
    return false;
  }

  // The oldest make room.
  void add(std::string question, std::string why, int64_t now) {
    octets_ += question.size() + why.size();
    all_.push_back({std::move(question), std::move(why), now + SECONDS});
    while (octets_ > MAX_OCTETS) drop_first();
  }

 private:
  struct Refusal {
    std::string question, why;
    int64_t until;
  };

  void drop_first() {
    octets_ -= all_.front().question.size() + all_.front().why.size();
    all_.pop_front();
  }

  std::deque<Refusal> all_;  // in the order of their ends
  size_t octets_ = 0;
};

// Whose permissions are whose. OpenDDS asks for the attributes of a topic with the permissions of
// the peer that announced it; they follow from our own governance.
class Permissions {
 public:
  void add_own(int32_t identity, int32_t own) { of_identity_[identity] = own; }

  void add_peers(int32_t permissions, int32_t identity, int32_t peer) {
    peers_[permissions] = {of_identity_[identity], peer};
  }

  // The permissions that tell how a topic is protected.
  int32_t governing(int32_t permissions) const {
    const auto found = peers_.find(permissions);
    return found == peers_.end() ? permissions : found->second.own;
  }

  // The identity of the peer that has these permissions; 0 if they are not a peer's.
  int32_t peer(int32_t permissions) const {
    const auto found = peers_.find(permissions);
    return found == peers_.end() ? 0 : found->second.identity;
  }

  void drop(int32_t permissions) {
    peers_.erase(permissions);
    for (auto each = of_identity_.begin(); each != of_identity_.end();)
      each = each->second == permissions ? of_identity_.erase(each) : std::next(each);
  }

 private:
  struct Peer {
    int32_t own, identity;
  };

  std::map<int32_t, int32_t> of_identity_;
  std::map<int32_t, Peer> peers_;
};

}  // namespace pqsec

#endif
