// What is connected where on the base's board.
#pragma once

#include <stdint.h>

#include <Arduino.h>

// Valve i at kFirstValvePin + i - 1, a driver's gate with a pull-down of at most 10 kohm: at a reset
// the pin becomes an input with a pull-up of some 100 kohm, and the valve, normally closed, closes.
static const uint32_t kFirstValvePin = 22;
static const uint32_t kFirstCurrentPin = 30;  // of the drivers' sense outputs, high with a current

// The gripper's two coils; without current it keeps its state.
static const int kGripperOpenPin = 38, kGripperClosePin = 39;
static const int kGripperClosedPin = 40, kGripperHoldsPin = 41;  // switches to ground

// Analogue inputs, 12 bits for 3.3 V, and their full scale.
static const int kBatteryPin = A0, kTankPin = A1, kSupplyPin = A2, kTemperaturePin = A3;
static const int kGyroPin = A4;
static const int32_t kBatteryFullScale = 200;      // [0.1 V]
static const int32_t kTankFullScale = 25000;       // [kPa]
static const int32_t kSupplyFullScale = 16000;     // [0.1 kPa]
static const int32_t kTemperatureFullScale = 3300; // [0.1 deg C], of 10 mV per deg C
static const int32_t kGyroZero = 2048;             // at no rate of turn [counts]

static const uint16_t kPort = 5000;  // that the board listens on
