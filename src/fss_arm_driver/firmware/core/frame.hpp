// The frames of docs/reference/protocol.md, as far as a link needs them: it writes telemetry and reads
// commands.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "blake2s.hpp"

namespace fss {

constexpr size_t kFrameSize = 72;

// What the servo drive controls, by its own numbers.
enum class Mode : uint8_t { Off = 0, Current = 1, Velocity = 11, Position = 21 };

// Flags of telemetry.
constexpr uint8_t kArmed = 1, kStopped = 2, kWatchdog = 4, kReferenced = 8;

// Flags of a command.
constexpr uint8_t kArm = 1, kStop = 2, kHold = 4, kClearFaults = 8, kHome = 16;

// Fields that change slowly and take turns.
enum class Slow : uint8_t {
  Faults = 1, Supply, Battery, Temperature, Firmware, Homings, Refused
};
constexpr uint8_t kSlowFields = 7;

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
  int32_t set_point;     // [0.01 A], [0.1 counts/s] or [counts], by mode
  int32_t velocity;      // of the profile [0.1 counts/s]
  int32_t acceleration;  // of the profile [10 counts/s^2]
};

// Why bytes are not a command frame, in the order of the checks.
enum class Refusal : uint8_t { None, Length, Magic, Version, Kind, Crc, Signature, Field };

// Writes the 72 bytes of `frame`, signed if there is a key.
void encode(const Telemetry& frame, const Key& key, uint8_t* data);

// Reads `command`, which is written only if Refusal::None is returned.
Refusal decode(const uint8_t* data, size_t size, const Key& key, Command& command);

// Whether a sequence number comes after another, modulo 2^32.
inline bool newer(uint32_t sequence, uint32_t than) {
  return sequence != than && sequence - than < 0x80000000u;
}

}  // namespace fss
