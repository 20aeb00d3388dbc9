#include "path.hpp"

#include <math.h>

namespace fss {
namespace {

constexpr uint64_t kHorizon = 120000000;  // within which a segment begins [us]
constexpr uint64_t kLead = 8000;          // from a reckoning to the middle of its effect [us]
constexpr double kGain = 4.0;             // of the correction [1/s]
constexpr double kReach = 0.25;           // what the joint covers in it is not too far off [s]
constexpr double kUnit = 0.1;             // of velocities on the wire [counts/s]

bool operator==(const Knot& one, const Knot& other) {
  return one.time == other.time && one.position == other.position &&
         one.velocity == other.velocity;
}

// The cubic that has both knots' positions and velocities (Hermite's).
Aim between(const Knot& begin, const Knot& end, uint64_t at) {
  const double duration = 1e-6 * static_cast<double>(end.time - begin.time);
  const double s = 1e-6 * static_cast<double>(at - begin.time) / duration;
  const double rise = static_cast<double>(end.position) - begin.position;
  const double a = duration * (kUnit * begin.velocity), b = duration * (kUnit * end.velocity);
  const double square = 3.0 * rise - 2.0 * a - b, cube = a + b - 2.0 * rise;
  return {begin.position + s * (a + s * (square + s * cube)),
          (a + s * (2.0 * square + s * 3.0 * cube)) / duration};
}

int32_t within(double value, int32_t most) {
  return value >= most ? most : value <= -most ? -most : static_cast<int32_t>(lround(value));
}

}  // namespace

// --- one path -----------------------------------------------------------------------------------

uint32_t Path::first() const {
  uint32_t index = present_;
  while (!piece(index).held) ++index;
  return index;
}

bool Path::has_begun(uint64_t now) const {
  return number_ != 0 && now >= piece(first()).begin.time;
}

uint16_t Path::complete() const {
  uint32_t index = present_;
  while (index < limit() && piece(index).held) ++index;
  return static_cast<uint16_t>(index);
}

bool Path::fits(const Segment& segment) const {
  const uint32_t index = segment.index;
  if (segment.path != number_) return index < kSegments;
  if (index < present_ || index >= limit()) return false;
  const bool last = segment.flags & kLast;
  for (uint32_t i = present_; i < limit(); ++i) {
    const Piece& held = piece(i);
    if (!held.held) continue;
    if (i < index ? held.last : i > index && last) return false;
    if (i + 1 == index && !(held.end == segment.begin)) return false;
    if (i == index + 1 && !(held.begin == segment.end)) return false;
    if (i != index) continue;
    if (held.last != last || !(held.begin == segment.begin) || !(held.end == segment.end)) {
      return false;
    }
  }
  return true;
}

void Path::put(const Segment& segment) {
  if (segment.path != number_) *this = Path();
  number_ = segment.path;
  pieces_[segment.index % kSegments] = {segment.begin, segment.end, (segment.flags & kLast) != 0,
                                        true};
}

bool Path::enter(uint64_t now) {
  for (uint32_t index = present_; index < kSegments; ++index) {
    const Piece& held = piece(index);
    if (!held.held || (held.end.time <= now && !held.last)) continue;
    while (present_ < index) pieces_[present_++ % kSegments].held = false;
    return held.begin.time <= now;
  }
  return false;
}

bool Path::advance(uint64_t now) {
  while (now >= piece(present_).end.time && !piece(present_).last) {
    pieces_[present_++ % kSegments].held = false;
    if (!piece(present_).held) return false;
  }
  return true;
}

Aim Path::aim(uint64_t at) const {
  const Knot &begin = piece(present_).begin, &end = piece(present_).end;
  if (at >= begin.time) return between(begin, end, at < end.time ? at : end.time);
  const double velocity = kUnit * begin.velocity;
  return {begin.position - velocity * 1e-6 * static_cast<double>(begin.time - at), velocity};
}

// --- the path followed and the next -------------------------------------------------------------

bool Follower::take(const Segment& segment, uint64_t now) {
  if (segment.end.time <= now) return false;
  if (segment.begin.time > now && segment.begin.time - now > kHorizon) return false;
  const uint16_t number = segment.path, later = next().number();
  Path& path = number == followed().number() ? followed() : next();
  if (number != path.number()) {
    if (latest_ && !newer(number, latest_)) return false;
    if (later && !newer(number, later)) return false;
  }
  if (!path.fits(segment)) return false;
  path.put(segment);
  return true;
}

void Follower::order(uint16_t number) {
  if (number != followed().number() && number != next().number()) leave();
  ordered_ = number;
}

void Follower::leave() {
  followed().clear();
  ordered_ = 0;
}

void Follower::clear() {
  leave();
  next().clear();
  latest_ = 0;
  broken_ = false;
}

void Follower::fail() {
  broken_ = broken_ || followed().number();
  followed().clear();
}

int32_t Follower::report() const {
  const Path& newest = next().number() ? next() : followed();
  if (!newest.number()) return 0;
  return static_cast<int32_t>(uint32_t{newest.number()} << 16 | newest.complete());
}

Demand Follower::demand(uint64_t now, const Command& command, const Measurement& measured) {
  Demand demand;
  demand.goal = Demand::Hold;
  if (!goes_on(now)) return demand;
  const Path& path = followed();
  const double error = path.aim(measured.clock).position - measured.position;
  if (!rests_ && fabs(error) > kReach * kUnit * command.velocity) {
    fail();
    return demand;
  }
  rests_ = rests_ || (path.is_over(measured.clock) && measured.at_rest());
  demand.acceleration = command.acceleration;
  demand.goal = Demand::Velocity;
  demand.set_point = within((path.aim(now + kLead).velocity + kGain * error) / kUnit, command.velocity);
  return demand;
}

// Whether a path is followed at `now`: the one that was, or the next, once it begins.
bool Follower::goes_on(uint64_t now) {
  bool goes = followed().number() && followed().advance(now);
  if (next().number() == ordered_ && next().has_begun(now)) {
    followed().clear();
    turn_ = 1 - turn_;
    latest_ = ordered_;
    broken_ = rests_ = false;
    goes = followed().enter(now);
  }
  if (!goes) fail();
  return goes;
}

}  // namespace fss
