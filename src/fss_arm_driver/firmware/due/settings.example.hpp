// What is this link's own. Copy to settings.hpp, which is not for the repository: it holds a key.
#pragma once

#include <stdint.h>

#include "blake2s.hpp"

static const uint8_t kLink = 1;  // 1 beside the base

// The network, and the port that the link listens on.
#define WIFI_NETWORK "fss"
#define WIFI_PASSWORD "change me"
static const uint16_t kPort = 5001;

// The link's key, 16 to 32 bytes, as in the computer's file of keys; size 0: frames are not signed.
static const fss::Key kKey = {0, {}};

// Wiring.
#define kDriveLine Serial1  // the RS-232 shield: TX1 is pin 18, RX1 is pin 19
static const int kTorqueDataPin = 5;
static const int kTorqueClockPin = 6;
static const int kBatteryPin = A0;            // behind a divider
static const uint32_t kBatteryFullScale = 200;  // battery at 3.3 V on the pin [0.1 V]
