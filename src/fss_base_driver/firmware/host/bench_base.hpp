// The base's hardware without hardware: valves that may fail, a tank that they empty, a gripper that
// takes a while, and a gyro with 1000 samples a second.
#pragma once

#include <stdint.h>

#include "base_board.hpp"

namespace fss {

class BenchBase : public BaseBoard {
 public:
  void restart() { now_ = samples_ = told_at_ = 0; }  // time starts at 0 again

  // Lets time pass until `now` [us].
  void pass(uint64_t now) {
    const uint64_t passed = now - now_;
    for (int i = 0; i < kValves; ++i) {
      if (open_ >> i & 1) flown_ += passed, opened[i] += passed;
    }
    now_ = now;
  }

  void open(uint8_t valves) override {
    driven = valves;
    open_ = static_cast<uint8_t>((valves | stuck_open) & ~stuck_closed);
  }
  bool gyro(int32_t& counts) override {
    if (now_ / 1000 == samples_ || !gyro_on) return false;
    ++samples_;
    counts = rate;
    return true;
  }
  uint8_t currents() override { return static_cast<uint8_t>((driven & ~cut) | shorted); }
  void grip(Grip grip) override {
    if (grip != told_) told_at_ = now_;
    told_ = grip;
  }
  uint8_t gripper() override {
    const bool closed = told_ == Grip::Close && now_ - told_at_ >= 300'000;
    return static_cast<uint8_t>(closed ? kClosed | (something ? kHolds : 0) : 0);
  }
  Readings readings() override {
    Readings read;
    read.tank = static_cast<int32_t>(20'000 - static_cast<int64_t>(flown_ / 100'000));
    read.supply = 7000;
    for (int i = 0; i < kValves; ++i) read.supply -= open_ >> i & 1 ? 50 : 0;
    read.battery = 148;
    read.temperature = 215;
    return read;
  }

  uint8_t driven = 0;                          // what the firmware wants open
  uint8_t stuck_open = 0, stuck_closed = 0;    // valves
  uint8_t cut = 0, shorted = 0;                // their wires
  int32_t rate = 0;                            // [counts]
  bool gyro_on = true, something = false;      // in the gripper
  uint64_t opened[kValves] = {};               // how long each was open [us]

 private:
  uint8_t open_ = 0;
  uint64_t now_ = 0, samples_ = 0, flown_ = 0, told_at_ = 0;
  Grip told_ = Grip::Keep;
};

}  // namespace fss
