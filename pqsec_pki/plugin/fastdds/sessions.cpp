// See sessions.hpp.

#include "sessions.hpp"

#include <algorithm>
#include <ctime>

namespace pqsec {
namespace {

constexpr int MOST_AT_ONCE = 1000;  // of revoked peers; the others come at the next look

std::mutex all_mutex;
std::vector<Sessions*> all;
thread_local const void* being_made = nullptr;

void note(const char* why) { fprintf(stderr, "pqsec: a peer is disconnected: %s\n", why); }

}  // namespace

Sessions::~Sessions() {
  agent::watch_end(&watch_);
  const std::lock_guard<std::mutex> guard(all_mutex);
  all.erase(std::remove(all.begin(), all.end(), this), all.end());
}

void Sessions::add(const Identity* peer) {
  const std::lock_guard<std::mutex> guard(mutex_);
  peers_.insert(peer);
}

void Sessions::remove(const Identity* peer) {
  const std::lock_guard<std::mutex> guard(mutex_);
  peers_.erase(peer);
}

void Sessions::lasts_until(handle_t peer, int64_t when) {
  const std::lock_guard<std::mutex> guard(mutex_);
  for (const auto* each : peers_)
    if (each->number == peer) each->lasts_until(when);
}

void Sessions::is_being_made() {
  if (being_made == nullptr) return;
  const std::lock_guard<std::mutex> guard(all_mutex);
  // Another at this address has gone.
  for (auto* each : all)
    if (each->discovery_ == being_made) each->discovery_ = nullptr;
  if (std::find(all.begin(), all.end(), this) == all.end()) all.push_back(this);
  discovery_ = being_made;
}

Sessions* Sessions::of(const void* discovery) {
  const std::lock_guard<std::mutex> guard(all_mutex);
  for (auto* each : all)
    if (each->discovery_ == discovery) return each;
  return nullptr;
}

std::vector<agent::guid> Sessions::expired() {
  std::vector<agent::guid> found;
  const int64_t now = time(nullptr);
  const std::lock_guard<std::mutex> guard(mutex_);
  for (const auto* each : peers_)
    if (each->end <= now) {
      note("its identity or permissions expired");
      found.push_back(each->guid);
      each->end = FOR_EVER;
    }
  return found;
}

std::vector<agent::guid> Sessions::revoked() {
  std::vector<agent::guid> found;
  const std::lock_guard<std::mutex> guard(mutex_);
  for (const auto* each : peers_)
    if (revoked_.count(each->number) != 0) {
      note("it was revoked");
      found.push_back(each->guid);
    }
  revoked_.clear();
  return found;
}

void Sessions::has_list() {
  agent::watch_look(&watch_, [](const void* sessions) {
    try {
      static_cast<Sessions*>(const_cast<void*>(sessions))->find_revoked();
    } catch (...) {
      // Without memory, the rest is asked for at the next look.
    }
  });
}

void Sessions::find_revoked() {
  for (int i = 0; i < MOST_AT_ONCE; i++) {
    SecurityException exception{std::string()};
    handle_t number = 0;
    if (link_.ask(exception, "find_revoked", ">h", &number) < 0 || number == 0) return;
    const std::lock_guard<std::mutex> guard(mutex_);
    revoked_.insert(number);
  }
}

}  // namespace pqsec

// Called by the preload library: before an object of discovery is made in this thread, and with
// nullptr after that.
PQSEC_EXPORT void pqsec_discovery(const void* made) noexcept { pqsec::being_made = made; }

// Calls `drop(context, guid)`, 16 octets, for each peer that this object of discovery must drop.
PQSEC_EXPORT void pqsec_lost(const void* discovery,
                             void (*drop)(void* context, const uint8_t* guid),
                             void* context) noexcept {
  try {
    if (auto* sessions = pqsec::Sessions::of(discovery))
      sessions->lost([&](const agent::guid& guid) { drop(context, guid.octets); });
  } catch (...) {
    // Without memory, they are looked for again at the next announcement.
  }
}
