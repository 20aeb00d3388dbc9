// What the core needs of the hardware that it runs on. Nothing here may block.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace fss {

class Board {
 public:
  // The serial line to the servo drive, 8N1.
  virtual void set_baud(uint32_t baud) = 0;
  virtual size_t read(uint8_t* data, size_t room) = 0;
  virtual bool write(const uint8_t* data, size_t size) = 0;  // all of it or nothing

  // The torque converter, an HX711: its data pin, and the data pin after one pulse of its clock
  // (which must stay below 50 us).
  virtual bool torque_pin() = 0;
  virtual bool torque_pulse() = 0;

  virtual uint16_t battery() = 0;  // [0.1 V]

 protected:
  ~Board() = default;
};

}  // namespace fss
