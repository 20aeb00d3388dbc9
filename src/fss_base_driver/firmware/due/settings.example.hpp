// What is this board's own. Copy to settings.hpp, which is not for the repository: it holds a key.
#pragma once

#include <stdint.h>

#include "blake2s.hpp"
#include "valves.hpp"

// The board's key, 16 to 32 bytes, as of link 0 in the computer's file of keys; size 0: frames are
// not signed.
static const fss::Key kKey = {0, {}};

// Longest pulse, allowance [us], duty [%], total time [us].
static const fss::Limits kValveLimits = fss::kLimits;

#define GYRO AnalogueGyro           // or SerialGyro
#define COMPUTER fss::WifiComputer  // or fss::WireComputer
#define WIFI_NETWORK "fss"
#define WIFI_PASSWORD "change me"
