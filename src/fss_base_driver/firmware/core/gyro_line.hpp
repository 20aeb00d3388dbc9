// A gyro that sends its rate of turn as lines of text, "-12.345678 1": degrees per second with six
// decimals, and 1 if it is valid. So does KVH's DSP-3000, 100 times a second (its technical manual,
// chapter 2). Lines have no checksum: a lost byte is detected only by a line's form.
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
    if (byte == ' ') part_ = part_ == Start || part_ >= Flag ? part_ : places_ == 6 ? Flag : Wrong;
    else if (part_ == Start && byte == '-') negative_ = true, part_ = Sign;
    else if (part_ == Digits && byte == '.' && !fraction_) fraction_ = true;
    else if (part_ <= Digits && byte >= '0' && byte <= '9') digit(byte - '0');
    else part_ = part_ == Flag && byte == '1' ? Valid : Wrong;
    return false;
  }

 private:
  enum Part : uint8_t { Start, Sign, Digits, Flag, Valid, Wrong };
  static constexpr int32_t kUnits = 100000;  // in a degree per second
  static constexpr int32_t kMost = 375 * kUnits;

  // What is below the unit is dropped.
  void digit(int32_t digit) {
    if (fraction_) {
      value_ += digit * place_;
      place_ /= 10;
      ++places_;
    } else {
      value_ = 10 * value_ + digit * kUnits;
    }
    part_ = value_ > kMost || places_ > 6 ? Wrong : Digits;
  }

  Part part_ = Wrong;  // at the start it may be in the midst of a line
  bool negative_ = false, fraction_ = false;
  uint8_t places_ = 0;  // behind the point
  int32_t value_ = 0, place_ = kUnits / 10;
};

}  // namespace fss
