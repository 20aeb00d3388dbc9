#include "path.hpp"

#include <math.h>

namespace fss {
namespace {

constexpr uint64_t kHorizon = 120000000;  // within which a segment must start [us]
constexpr double kGain = 4.0;             // of the correction [1/s]
constexpr double kReach = 0.25;           // largest error, in time at the path's limit [s]
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
  return value >= most ? most : value <= -most ? -most : static_cast<int32_t>(lrint(value));
}

}  // namespace

// --- one path -----------------------------------------------------------------------------------

bool Path::has_begun(uint64_t now) const {
  uint32_t index = present_;
  while (!piece(index).held) ++index;
  return now >= piece(index).begin.time;
}

uint16_t Path::missing() const {
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

bool Path::advance(uint64_t now) {
  for (uint32_t index = present_, end = limit(); index < end; ++index) {
    Piece& held = pieces_[index % kSegments];
    if (!held.held) continue;
    present_ = index;
    if (now < held.end.time || held.last) return now >= held.begin.time;
    held.held = false;
  }
  return false;
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

void Follower::leave() { followed().clear(); }

void Follower::clear() {
  followed().clear();
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
  return static_cast<int32_t>(uint32_t{newest.number()} << 16 | newest.missing());
}

Demand Follower::demand(uint64_t now, uint32_t lead, const Command& command,
                        const Measurement& measured) {
  choose(static_cast<uint16_t>(command.set_point), now);
  Demand demand;
  demand.goal = Demand::Hold;
  if (!followed().number()) return demand;
  Path& path = followed();
  const bool known = path.advance(now);
  const double error = known ? path.aim(measured.clock).position - measured.position : 0.0;
  if (!known || fabs(error) > kReach * kUnit * command.velocity) {
    fail();
    return demand;
  }
  rests_ = rests_ || (path.is_over(measured.clock) && measured.at_rest());
  const double velocity = path.aim(now + lead).velocity + kGain * error;
  demand.goal = Demand::Velocity;
  demand.set_point = within(velocity / kUnit, command.velocity);
  demand.acceleration = command.acceleration;
  return demand;
}

// The next path is followed once it has come and begun; until then the one before.
void Follower::choose(uint16_t number, uint64_t now) {
  if (number == next().number()) {
    if (!next().has_begun(now)) return;
    followed().clear();
    turn_ = 1 - turn_;
    latest_ = number;
    broken_ = rests_ = false;
  } else if (latest_ && number != latest_ && !newer(number, latest_)) {
    leave();
  }
}

}  // namespace fss
