// The frames of docs/reference/base_protocol.md: the base's board writes telemetry, and reads commands.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frame.hpp"

namespace fss {

constexpr uint8_t kBoard = 0;  // its number, where frames have that of a link
constexpr uint8_t kValves = 8;
constexpr uint32_t kTimeUnit = 100;  // of on times and of a pulse's age [us]

// Flags of telemetry, beside those of all boards.
constexpr uint8_t kLimited = 8, kSpent = 16;

// What a command says to the gripper.
enum class Grip : uint8_t { Keep, Open, Close };

// What telemetry says of the gripper.
constexpr uint8_t kToldToClose = 1, kClosed = 2, kHolds = 4;

// Fields that change slowly and take turns.
enum class BaseSlow : uint8_t {
  Tank = 1, Supply, Battery, Temperature, Firmware, Refused, Faults, Left, Open1,
  Open8 = Open1 + kValves - 1
};
constexpr uint8_t kBaseSlowFields = 16;

struct BaseTelemetry : Header {
  uint32_t echo;          // of the clock of the last command taken
  uint32_t turnaround;    // from its arrival to the measurement [us]
  uint32_t gyro_sum;      // of all samples since the start [counts]
  uint16_t gyro_samples;  // how many these are
  uint8_t valves;         // bit i - 1: valve i is open
  uint8_t gripper;
  uint16_t pulse;         // number of the one begun last; 0: none since the start
  uint16_t pulse_age;     // [kTimeUnit]; 65535: or more
  BaseSlow slow_id;
  int32_t slow_value;
};

struct BaseCommand : Order {
  uint16_t pulse;              // 0: none
  uint16_t on_times[kValves];  // [kTimeUnit]
  Grip grip;
};

// Writes the 72 bytes of `frame`, signed if there is a key.
void encode(const BaseTelemetry& frame, const Key& key, uint8_t* data);

// Reads `command`, which is written only if Refusal::None is returned.
Refusal decode(const uint8_t* data, size_t size, const Key& key, BaseCommand& command);

}  // namespace fss
