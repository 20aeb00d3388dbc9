// What the core needs of the hardware that the base's board has. Nothing here may block.
#pragma once

#include <stdint.h>

#include "base_frame.hpp"

namespace fss {

// What changes slowly, in the units of telemetry.
struct Readings {
  int32_t tank;         // [kPa]
  int32_t supply;       // [0.1 kPa]
  int32_t battery;      // [0.1 V]
  int32_t temperature;  // [0.1 deg C]
};

class BaseBoard {
 public:
  // Has these valves open and all others closed; bit i - 1: valve i.
  virtual void open(uint8_t valves) = 0;

  // The gyro's next sample, if there is one.
  virtual bool gyro(int32_t& counts) = 0;

  virtual uint8_t currents() = 0;  // which valves draw current
  virtual void grip(Grip grip) = 0;
  virtual uint8_t gripper() = 0;   // kClosed, kHolds
  virtual Readings readings() = 0;

  // Between these two `Base::tick` is not run, where that is an interrupt's.
  virtual void lock() {}
  virtual void unlock() {}

 protected:
  ~BaseBoard() = default;
};

}  // namespace fss
