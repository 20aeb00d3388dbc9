#include "gate.hpp"

namespace fss {

bool Gate::silent(uint64_t now) const {
  return taken_ == 0 || now - arrival_ > 1000u * uint64_t{command_.watchdog};
}

Taken Gate::take(const uint8_t* data, size_t size, uint64_t now, Follower* paths) {
  Frame frame;
  const bool whole = decode(data, size, key_, frame) == Refusal::None;
  const Taken taken = whole ? take(frame, now, paths) : Taken::Nothing;
  refused_ += taken == Taken::Nothing;
  return taken;
}

Taken Gate::take(const Frame& frame, uint64_t now, Follower* paths) {
  if (frame.kind == Kind::Segment) {
    const Segment& segment = frame.segment;
    const bool replayed = key_.size && segment.clock <= unarmed_;
    const bool ours = paths && segment.link == link_ && segment.boot == boot_ && !replayed;
    return ours && paths->take(segment, now) ? Taken::Segment : Taken::Nothing;
  }
  const Command& command = frame.command;
  if (!admits(command, now)) return Taken::Nothing;
  if (follows(command, now)) newest_ = command.sequence;
  if (command.clock > latest_) latest_ = command.clock;
  if (!(command.flags & kArm)) unarmed_ = command.clock;
  command_ = command;
  arrival_ = now;
  ++taken_;
  return Taken::Command;
}

bool Gate::admits(const Command& command, uint64_t now) const {
  const bool stop = command.flags & kStop;
  if (command.link != link_) return false;
  if (!stop && command.boot != 0 && command.boot != boot_) return false;
  if (!stop && !follows(command, now)) return false;
  if (key_.size && taken_ && command.clock <= latest_) return false;  // a replay, be it a stop
  return command.expiry == 0 || command.expiry >= now;
}

// Whether it is newer than the last command, or may begin a session.
bool Gate::follows(const Command& command, uint64_t now) const {
  if (silent(now)) return !(command.flags & kArm);
  return newer(command.sequence, newest_);
}

}  // namespace fss
