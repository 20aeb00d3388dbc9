// The firmware of a link on the Arduino Due. Building and wiring: docs/how-to/firmware.md.

#include <Arduino.h>

#include "due_board.hpp"
#include "link.hpp"
#include "settings.hpp"

static const uint64_t kDriveTime = 2000000;      // to find the drive and bring it to rest [us]
static const uint32_t kPatience = 10000;         // without a network [ms]
static const uint32_t kHardwareWatchdog = 1000;  // [ms]

static LINK_BOARD board;

// A random number that is never 0: the board has no memory to count its starts in.
static uint16_t start_number() {
  uint16_t number = 0;
  pmc_enable_periph_clk(ID_TRNG);
  trng_enable(TRNG);
  while (number == 0) number = static_cast<uint16_t>(trng_read_output_data(TRNG));
  return number;
}

static fss::Link& firmware() {
  static fss::Link link(kLink, start_number(), kKey, board);
  return link;
}

// The hardware's watchdog can be set once only and begins with 16 s. That is left so for setup(),
// where the network may take seconds; the Arduino core would switch it off here.
void watchdogSetup() {}

void setup() {
  board.begin();
  // The last program may have ended in the midst of a move: the drive comes first.
  while (board.now() < kDriveTime) firmware().poll(board.now());
  while (!board.connect()) {}
  watchdogEnable(kHardwareWatchdog);
}

// The Wi-Fi library comes back from a lost network only by steps that take seconds: a start anew is
// simpler, once the link's own watchdog has long had the joint held.
void loop() {
  static uint32_t online = 0, looked = 0;
  watchdogReset();
  firmware().poll(board.now());
  const uint32_t now = millis();
  if (now - looked < 1000) return;
  looked = now;
  if (board.online()) online = now;
  if (now - online > kPatience && !(firmware().flags() & fss::kArmed)) NVIC_SystemReset();
}
