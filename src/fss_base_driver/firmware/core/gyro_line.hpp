// A gyro that sends its rate of turn as lines of text, "  -0.01234 1": degrees per second, clockwise,
// and 1 if that is valid. So do the fibre-optic ones of KVH's DSP-3000 series, 100 times a second.
#pragma once

#include <stdint.h>

namespace fss {

class GyroLine {
 public:
  // Takes a byte; whether it ends a line with a valid rate, which is `counts` then [1e-5 deg/s].
  bool take(char byte, int32_t& counts) {
    if (byte == '\r' || byte == '\n') {
      const bool valid = part_ == Valid;
      if (valid) counts = static_cast<int32_t>(negative_ ? -value_ : value_);
      *this = GyroLine();
      part_ = Start;
      return valid;
    }
    if (byte == ' ') part_ = part_ == Digits ? Flag : part_ == Sign ? Wrong : part_;
    else if (part_ == Start && (byte == '-' || byte == '+')) negative_ = byte == '-', part_ = Sign;
    else if (part_ == Digits && byte == '.' && !fraction_) fraction_ = true;
    else if (part_ <= Digits && byte >= '0' && byte <= '9') digit(byte - '0');
    else part_ = part_ == Flag && byte == '1' ? Valid : Wrong;
    return false;
  }

 private:
  enum Part : uint8_t { Start, Sign, Digits, Flag, Valid, Wrong };
  static constexpr int32_t kUnits = 100000;  // in a degree per second

  // Those beyond the unit are dropped.
  void digit(int32_t digit) {
    part_ = Digits;
    if (fraction_) {
      value_ += digit * place_;
      place_ /= 10;
    } else {
      value_ = 10 * value_ + digit * kUnits;
      if (value_ >= 1000 * kUnits) part_ = Wrong;
    }
  }

  Part part_ = Wrong;  // at the start it may be in the midst of a line
  bool negative_ = false, fraction_ = false;
  int32_t value_ = 0, place_ = kUnits / 10;
};

}  // namespace fss
