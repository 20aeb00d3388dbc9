#include "gate.hpp"

namespace fss {

bool Gate::silent(uint64_t now) const {
  return taken_ == 0 || now - arrival_ > 1000u * uint64_t{order_.watchdog};
}

uint32_t Gate::turnaround(uint64_t now) const {
  const uint64_t since = taken_ ? now - arrival_ : 0;
  return static_cast<uint32_t>(since < UINT32_MAX ? since : UINT32_MAX);
}

bool Gate::take(const Order& order, uint64_t now) {
  if (!admits(order, now)) return false;
  if (follows(order, now)) newest_ = order.sequence;
  if (!(order.flags & kArm)) unarmed_ = order.clock;
  order_ = order;
  arrival_ = now;
  ++taken_;
  return true;
}

bool Gate::is_current(const Header& header) const {
  const bool replayed = signed_ && header.clock <= unarmed_;
  return header.link == link_ && header.boot == boot_ && !replayed;
}

bool Gate::admits(const Order& order, uint64_t now) const {
  const bool stop = order.flags & kStop;
  if (order.link != link_) return false;
  if (!stop && order.boot != 0 && order.boot != boot_) return false;
  if (!stop && !follows(order, now)) return false;
  if (signed_ && taken_ && order.clock <= order_.clock) return false;  // a replay, be it a stop
  return order.expiry == 0 || order.expiry >= now;
}

// Returns true if it is newer than the last command, or may start a session.
bool Gate::follows(const Order& order, uint64_t now) const {
  if (silent(now)) return !(order.flags & kArm);
  return newer(order.sequence, newest_);
}

}  // namespace fss
