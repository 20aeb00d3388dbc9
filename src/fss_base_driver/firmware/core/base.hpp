// The electronics of the base: commands in, valves and gripper driven, telemetry out.
// See docs/reference/base_protocol.md, The board.
//
// Two callers: `tick`, from a timer's interrupt where there is one, closes valves that are due and
// samples the gyro; `poll`, from a loop that may be late or hang, does the rest.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "base_board.hpp"
#include "computer.hpp"
#include "gate.hpp"
#include "valves.hpp"

namespace fss {

constexpr int32_t kBaseFirmware = 0x010000;  // 1.0.0
constexpr uint32_t kBasePeriod = 50000;      // of telemetry [us]
constexpr uint32_t kSettled = 20000;         // a valve's current, after it was switched [us]

class Base {
 public:
  // `boot`: not as at the last start, never 0.
  Base(uint16_t boot, const Key& key, BaseBoard& board, Computer& computer,
       const Limits& limits = kLimits)
      : boot_(boot), key_(key), board_(board), computer_(computer), valves_(limits),
        gate_(kBoard, boot, key.size != 0) {}

  // `now` is the time since the start [us].
  void tick(uint64_t now);
  void poll(uint64_t now);

  const Gate& gate() const { return gate_; }
  const Valves& valves() const { return valves_; }
  const BaseCommand& command() const { return command_; }  // the last one taken

 private:
  bool take(const uint8_t* data, size_t size, uint64_t now);
  void watch_currents();
  void report();
  int32_t slow_value(BaseSlow slow, const Readings& readings) const;

  const uint16_t boot_;
  const Key key_;
  BaseBoard& board_;
  Computer& computer_;

  // Shared by the two callers, under the board's lock.
  Valves valves_;
  uint8_t driven_ = 0;              // the valves
  uint64_t switched_[kValves] = {}; // when each was last [us]
  uint32_t gyro_sum_ = 0;
  uint16_t gyro_samples_ = 0;

  Gate gate_;
  BaseCommand command_ = {};
  Grip grip_ = Grip::Keep;  // last command
  uint16_t faults_ = 0;     // last seen: no current (low byte), current without a command
  uint64_t due_ = 0;        // the next frame
  uint32_t sequence_ = 0;   // of it
};

}  // namespace fss
