// The firmware of a link on the Arduino Due. Building and wiring: docs/how-to/firmware.md.

#include <Arduino.h>

#include "due_board.hpp"
#include "due_computer.hpp"
#include "link.hpp"
#include "settings.hpp"

static const uint64_t kDriveTime = 2000000;      // to find the drive and bring it to rest [us]
static const uint32_t kPatience = 10000;         // without a network [ms]
static const uint32_t kHardwareWatchdog = 1000;  // [ms]

static DueBoard board;
static COMPUTER computer;
static fss::DueClock the_clock;

static fss::Link& firmware() {
  static fss::Link link(kLink, fss::start_number(), kKey, board, computer, kSerial);
  return link;
}

// The hardware's watchdog can be set once only and begins with 16 s. That is left so for setup(),
// where the network may take seconds; the Arduino core would switch it off here.
void watchdogSetup() {}

void setup() {
  board.begin();
  // The last program may have ended in the midst of a move: the drive comes first.
  while (the_clock.now() < kDriveTime) firmware().poll(the_clock.now());
  while (!computer.connect(WIFI_NETWORK, WIFI_PASSWORD, kPort)) {}
  watchdogEnable(kHardwareWatchdog);
}

// The Wi-Fi library comes back from a lost network only by steps that take seconds: a start anew is
// simpler, once the link's own watchdog has long had the joint held.
void loop() {
  static uint32_t online = 0, looked = 0;
  watchdogReset();
  firmware().poll(the_clock.now());
  const uint32_t now = millis();
  if (now - looked < 1000) return;
  looked = now;
  if (computer.online()) online = now;
  if (now - online > kPatience && !(firmware().flags() & fss::kArmed)) NVIC_SystemReset();
}
