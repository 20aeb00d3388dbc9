// What is this link's own. Copy to settings.hpp, which is not for the repository: it holds a key.
#pragma once

#include <stdint.h>

#include "blake2s.hpp"

static const uint8_t kLink = 1;  // 1 beside the base

// Serial number of this physical link, wherever it is mounted; 0: it has none.
static const int32_t kSerial = 0;

// The link's key, 16 to 32 bytes, as in the computer's file of keys; size 0: frames are not signed.
static const fss::Key kKey = {0, {}};

#define COMPUTER fss::WifiComputer  // or fss::WireComputer
#define WIFI_NETWORK "fss"
#define WIFI_PASSWORD "change me"
