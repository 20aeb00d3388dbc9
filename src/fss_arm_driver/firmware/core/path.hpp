// Timed paths stored by a link, and the demand on its drive that follows one.
// See docs/reference/protocol.md, Following a path.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "drive.hpp"
#include "link_frame.hpp"

namespace fss {

constexpr uint16_t kSegments = 32;  // that are kept of a path

// Where a path is at a time.
struct Aim {
  double position;  // [counts]
  double velocity;  // [counts/s]
};

// One path, as far as its segments have come: those from the present one on.
class Path {
 public:
  uint16_t number() const { return number_; }  // 0: none is held
  uint16_t missing() const;                    // index of the first that is still to come
  bool has_begun(uint64_t now) const;          // the first segment held, if one is

  bool fits(const Segment& segment) const;  // by the rules 4 and 5
  void put(const Segment& segment);         // of another path: that one is gone
  void clear() { number_ = 0; }

  // Makes the segment at `now` the present one; false: it has not come.
  bool advance(uint64_t now);

  // Of the present segment, or straight on before it.
  Aim aim(uint64_t at) const;
  bool is_over(uint64_t at) const {  // the last knot
    return piece(present_).last && at >= piece(present_).end.time;
  }

 private:
  struct Piece {
    Knot begin, end;
    bool last, held;
  };

  const Piece& piece(uint32_t index) const { return pieces_[index % kSegments]; }
  uint32_t limit() const { return uint32_t{present_} + kSegments; }  // above all that are held

  uint16_t number_ = 0;
  uint32_t present_ = 0;          // index of the segment followed
  Piece pieces_[kSegments] = {};  // index modulo their number
};

// The path that is followed and the next one.
class Follower {
 public:
  bool take(const Segment& segment, uint64_t now);  // by the rules 2 to 5

  void leave();  // the link is to do something else
  void clear();  // it is disarmed
  void fail();   // the drive cannot follow, if it is following

  bool following() const { return followed().number() && !rests_; }
  bool broken() const { return broken_; }
  int32_t report() const;  // the slow field of telemetry
  bool holds_none() const { return !followed().number() && !next().number(); }

  // Returns the demand on the drive at `now`, for the active command of mode 31; `lead` is the time
  // until half of the velocity step is reached [us].
  Demand demand(uint64_t now, uint32_t lead, const Command& command, const Measurement& measured);

 private:
  void choose(uint16_t number, uint64_t now);

  Path& followed() { return paths_[turn_]; }
  Path& next() { return paths_[1 - turn_]; }
  const Path& followed() const { return paths_[turn_]; }
  const Path& next() const { return paths_[1 - turn_]; }

  Path paths_[2];
  uint8_t turn_ = 0;     // which of them is followed
  uint16_t latest_ = 0;  // number of the path followed last, though it be gone; 0: none
  bool broken_ = false;
  bool rests_ = false;   // at the end of the path
};

}  // namespace fss
