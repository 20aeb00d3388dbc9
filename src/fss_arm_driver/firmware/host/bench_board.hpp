// A board without hardware: a simulated drive on its serial line, and a torque converter with 80
// samples a second.
#pragma once

#include <stdint.h>

#include "board.hpp"
#include "drive_model.hpp"

namespace fss {

class BenchBoard : public Board {
 public:
  void pass(uint64_t now) { now_ = now; }  // lets time pass until `now` [us]
  DriveModel& drive() { return drive_; }

  void set_baud(uint32_t baud) override { drive_.set_baud(baud, now_); }
  size_t read(uint8_t* data, size_t room) override { return drive_.read(data, room, now_); }
  bool write(const uint8_t* data, size_t size) override {
    drive_.write(data, size, now_);
    return true;
  }
  bool torque_pin() override { return now_ / 12'500 == samples_; }
  bool torque_pulse() override {
    if (pulses_ == 0) shifted_ = static_cast<uint32_t>(torque);
    const bool bit = shifted_ >> 23 & 1;
    shifted_ <<= 1;
    if (++pulses_ == 25) {
      pulses_ = 0;
      samples_ = now_ / 12'500;
    }
    return bit;
  }
  uint16_t battery() override { return 148; }

  int32_t torque = 0;  // [counts]

 private:
  DriveModel drive_;
  uint64_t now_ = 0, samples_ = 0;
  uint32_t shifted_ = 0;
  int pulses_ = 0;
};

}  // namespace fss
