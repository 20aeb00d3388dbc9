// The Arduino Due with a link's hardware: RS-232 to the servo drive, the load cell amplifier on two
// pins, a battery.
#pragma once

#include <Arduino.h>

#include "board.hpp"
#include "wiring.hpp"

class DueBoard : public fss::Board {
 public:
  void begin() {
    pinMode(kTorqueDataPin, INPUT_PULLUP);  // without an amplifier there is never a sample
    pinMode(kTorqueClockPin, OUTPUT);
    digitalWrite(kTorqueClockPin, HIGH);  // off and on: it may be in the midst of a reading
    delayMicroseconds(100);
    digitalWrite(kTorqueClockPin, LOW);
    analogReadResolution(12);
  }

  void set_baud(uint32_t baud) override { DRIVE_LINE.begin(baud); }
  size_t read(uint8_t* data, size_t room) override {
    size_t size = 0;
    while (size < room && DRIVE_LINE.available() > 0) {
      data[size++] = static_cast<uint8_t>(DRIVE_LINE.read());
    }
    return size;
  }
  bool write(const uint8_t* data, size_t size) override {
    if (DRIVE_LINE.availableForWrite() < static_cast<int>(size)) return false;
    return DRIVE_LINE.write(data, size) == size;
  }

  bool torque_pin() override { return digitalRead(kTorqueDataPin) == HIGH; }
  bool torque_pulse() override {
    noInterrupts();  // high for over 60 us switches the amplifier off
    digitalWrite(kTorqueClockPin, HIGH);
    delayMicroseconds(1);
    const bool bit = torque_pin();
    digitalWrite(kTorqueClockPin, LOW);
    interrupts();
    delayMicroseconds(1);
    return bit;
  }

  uint16_t battery() override {
    return static_cast<uint16_t>(analogRead(kBatteryPin) * kBatteryFullScale / 4095);
  }
};
