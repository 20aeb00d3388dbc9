// The Arduino Due with the base's hardware: valves, gripper, gyro and analogue instruments.
#pragma once

#include <Arduino.h>

#include "base_board.hpp"
#include "due_computer.hpp"
#include "gyro_line.hpp"
#include "settings.hpp"
#include "wiring.hpp"

static const uint32_t kTickRate = 10000;  // of the timer [Hz]: an on time's unit

// Sampled by the timer, 1000 times a second, because the rate of the loop is not steady.
class AnalogueGyro {
 public:
  void begin() {}
  bool sample(int32_t& counts) {
    if (++ticks_ % 10 != 0) return false;
    counts = static_cast<int32_t>(analogRead(kGyroPin)) - kGyroZero;
    return true;
  }

 private:
  uint8_t ticks_ = 0;
};

// At the RS-232 shield's line: RX1 is pin 19.
class SerialGyro {
 public:
  void begin() { Serial1.begin(38400); }
  bool sample(int32_t& counts) {
    return Serial1.available() > 0 && line_.take(static_cast<char>(Serial1.read()), counts);
  }

 private:
  fss::GyroLine line_;
};

class DueBase : public fss::BaseBoard {
 public:
  // Valves first: until their pins are outputs, pull-downs keep them closed.
  void begin() {
    for (uint32_t i = 0; i < fss::kValves; ++i) {
      digitalWrite(kFirstValvePin + i, LOW);
      pinMode(kFirstValvePin + i, OUTPUT);
      pinMode(kFirstCurrentPin + i, INPUT);
    }
    pinMode(kGripperOpenPin, OUTPUT);
    pinMode(kGripperClosePin, OUTPUT);
    pinMode(kGripperClosedPin, INPUT_PULLUP);
    pinMode(kGripperHoldsPin, INPUT_PULLUP);
    analogReadResolution(12);
    gyro_.begin();
  }

  // Has TC3_Handler called `kTickRate` times a second from now on.
  void start_timer() {
    pmc_enable_periph_clk(ID_TC3);
    TC_Configure(TC1, 0, TC_CMR_WAVE | TC_CMR_WAVSEL_UP_RC | TC_CMR_TCCLKS_TIMER_CLOCK1);
    TC_SetRC(TC1, 0, VARIANT_MCK / 2 / kTickRate);
    TC1->TC_CHANNEL[0].TC_IER = TC_IER_CPCS;
    NVIC_SetPriority(TC3_IRQn, 0);
    NVIC_EnableIRQ(TC3_IRQn);
    TC_Start(TC1, 0);
  }

  void open(uint8_t valves) override {
    for (uint32_t i = 0; i < fss::kValves; ++i) {
      if ((valves ^ open_) >> i & 1) digitalWrite(kFirstValvePin + i, valves >> i & 1u);
    }
    open_ = valves;
  }

  bool gyro(int32_t& counts) override { return gyro_.sample(counts); }

  uint8_t currents() override {
    uint8_t currents = 0;
    for (uint32_t i = 0; i < fss::kValves; ++i) {
      if (digitalRead(kFirstCurrentPin + i) == HIGH) currents |= static_cast<uint8_t>(1 << i);
    }
    return currents;
  }
  void grip(fss::Grip grip) override {
    digitalWrite(kGripperOpenPin, grip == fss::Grip::Open ? HIGH : LOW);
    digitalWrite(kGripperClosePin, grip == fss::Grip::Close ? HIGH : LOW);
  }
  uint8_t gripper() override {
    return static_cast<uint8_t>((digitalRead(kGripperClosedPin) == LOW ? fss::kClosed : 0) |
                                (digitalRead(kGripperHoldsPin) == LOW ? fss::kHolds : 0));
  }
  fss::Readings readings() override {
    fss::Readings read;
    read.tank = scaled(kTankPin, kTankFullScale);
    read.supply = scaled(kSupplyPin, kSupplyFullScale);
    read.battery = scaled(kBatteryPin, kBatteryFullScale);
    read.temperature = scaled(kTemperaturePin, kTemperatureFullScale);
    return read;
  }

  void lock() override {
    noInterrupts();
    ++locks_;
  }
  void unlock() override {
    if (--locks_ == 0) interrupts();
  }

 private:
  // One conversion takes some microseconds; the timer's would disturb it.
  int32_t scaled(int pin, int32_t full_scale) {
    const fss::NoInterrupts alone;
    return static_cast<int32_t>(analogRead(static_cast<uint32_t>(pin))) * full_scale / 4095;
  }

  GYRO gyro_;
  uint8_t open_ = 0, locks_ = 0;
};
