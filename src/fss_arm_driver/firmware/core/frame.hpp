// The frames of docs/reference/protocol.md, as far as a link needs them: it writes telemetry, and
// reads commands and segments of paths.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "blake2s.hpp"

namespace fss {

constexpr size_t kFrameSize = 72;

enum class Kind : uint8_t { Telemetry = 1, Command, Segment };

// What the servo drive controls, by its own numbers, and a path, which is ours.
enum class Mode : uint8_t { Off = 0, Current = 1, Velocity = 11, Position = 21, Path = 31 };

// Flags of telemetry.
constexpr uint8_t kArmed = 1, kStopped = 2, kWatchdog = 4, kReferenced = 8, kFollowing = 16,
                  kBroken = 32;

// Flags of a command.
constexpr uint8_t kArm = 1, kStop = 2, kHold = 4, kClearFaults = 8, kHome = 16;

// Flag of a segment.
constexpr uint8_t kLast = 1;

// Fields that change slowly and take turns.
enum class Slow : uint8_t {
  Faults = 1, Supply, Battery, Temperature, Firmware, Homings, Refused, Path
};
constexpr uint8_t kSlowFields = 8;

struct Telemetry {
  uint8_t link;
  uint8_t flags;
  uint16_t boot;
  uint32_t sequence;
  uint64_t clock;        // at the measurement [us since the start]
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

struct Command {
  uint8_t link;
  uint8_t flags;
  uint16_t boot;
  uint32_t sequence;
  uint64_t clock;        // the computer's stamp [us]
  uint64_t expiry;       // in the link's clock [us]; 0: none
  Mode mode;
  uint16_t watchdog;     // [ms]
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

struct Segment {
  uint8_t link;
  uint8_t flags;
  uint16_t boot;
  uint32_t sequence;
  uint64_t clock;        // the computer's stamp [us]
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

// Why bytes are not a frame for a link, in the order of the checks.
enum class Refusal : uint8_t { None, Length, Magic, Version, Kind, Crc, Signature, Field };

// Writes the 72 bytes of `frame`, signed if there is a key.
void encode(const Telemetry& frame, const Key& key, uint8_t* data);

// Reads `frame`, which is written only if Refusal::None is returned.
Refusal decode(const uint8_t* data, size_t size, const Key& key, Frame& frame);

// Whether a number comes after another of the same size, modulo that.
template <typename Unsigned>
bool newer(Unsigned number, Unsigned than) {
  const auto ahead = static_cast<Unsigned>(number - than);
  return ahead != 0 && ahead <= static_cast<Unsigned>(~Unsigned{0}) / 2;
}

}  // namespace fss
