// The torque converter, read when it has a sample and never waited for.
#pragma once

#include <stdint.h>

#include "board.hpp"

namespace fss {

struct Torque {
  int32_t counts = 0;   // 24 bits
  uint64_t clock = 0;   // when it was read [us]
  bool any = false;     // since the start

  // HX711: data low says that there is a sample; 24 pulses shift it out, the highest bit first, and
  // a 25th chooses channel A with gain 128 for the next. That takes some 50 us.
  void poll(Board& board, uint64_t now) {
    if (board.torque_pin()) return;
    uint32_t bits = 0;
    for (int i = 0; i < 24; ++i) bits = bits << 1 | (board.torque_pulse() ? 1u : 0u);
    board.torque_pulse();
    counts = static_cast<int32_t>(bits ^ 0x800000u) - 0x800000;
    clock = now;
    any = true;
  }

  // At the time `at` [us], in [ms]; 255: 255 or more.
  uint8_t age(uint64_t at) const {
    const uint64_t passed = any ? (at > clock ? (at - clock) / 1000 : 0) : 255;
    return static_cast<uint8_t>(passed < 255 ? passed : 255);
  }
};

}  // namespace fss
