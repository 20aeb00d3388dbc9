// The frames of docs/reference/protocol.md that are a link's own: it writes telemetry, and reads
// commands and segments of paths.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frame.hpp"

namespace fss {

// What the servo drive controls, by its own numbers, and a path, which is ours.
enum class Mode : uint8_t { Off = 0, Current = 1, Velocity = 11, Position = 21, Path = 31 };

// Flags of telemetry, beside those of all boards.
constexpr uint8_t kReferenced = 8, kFollowing = 16, kBroken = 32;

// Flags of a command, beside those to all boards.
constexpr uint8_t kHold = 4, kClearFaults = 8, kHome = 16;

// Flag of a segment.
constexpr uint8_t kLast = 1;

// Fields that change slowly and take turns.
enum class Slow : uint8_t {
  Faults = 1, Supply, Battery, Temperature, Firmware, Homings, Refused, Path, Serial
};
constexpr uint8_t kSlowFields = 9;

struct Telemetry : Header {
  uint32_t echo;         // of the clock of the last command taken
  uint32_t turnaround;   // from its arrival to the measurement [us]
  int32_t position;      // [counts]
  int32_t velocity;      // [0.1 counts/s]
  int16_t current;       // [0.01 A]
  Mode mode;
  Slow slow_id;
  uint32_t status;       // the drive's status word
  int32_t torque;        // 24 bits [counts]
  uint8_t torque_age;    // [ms]; 255: or more
  int32_t slow_value;
};

struct Command : Order {
  Mode mode;
  int32_t set_point;     // [0.01 A], [0.1 counts/s], [counts] or number of a path, by mode
  int32_t velocity;      // of the profile; of a path the most [0.1 counts/s]
  int32_t acceleration;  // likewise [10 counts/s^2]
};

// Where a path is at a time.
struct Knot {
  uint64_t time;         // by the link's clock [us]
  int32_t position;      // [counts]
  int32_t velocity;      // [0.1 counts/s]
};

struct Segment : Header {
  uint16_t path;         // its number, never 0
  uint16_t index;        // of the segment
  Knot begin, end;       // 1 ms to 60 s apart
};

// What came: of `command` and `segment` the one that `kind` says.
struct Frame {
  Kind kind;
  Command command;
  Segment segment;
};

// Writes the 72 bytes of `frame`, signed if there is a key.
void encode(const Telemetry& frame, const Key& key, uint8_t* data);

// Reads `frame`, which is written only if Refusal::None is returned.
Refusal decode(const uint8_t* data, size_t size, const Key& key, Frame& frame);

}  // namespace fss
