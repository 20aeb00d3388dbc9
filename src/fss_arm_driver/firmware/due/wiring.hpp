// What is connected where, alike for all links.
#pragma once

#include <Arduino.h>

#define DRIVE_LINE Serial1  // the RS-232 shield: TX1 is pin 18, RX1 is pin 19

static const int kTorqueDataPin = 5;
static const int kTorqueClockPin = 6;
static const int kBatteryPin = A0;              // behind a divider
static const uint32_t kBatteryFullScale = 200;  // battery at 3.3 V on the pin [0.1 V]

static const uint16_t kPort = 5001;  // that the link listens on
