// The firmware of the base's board on the Arduino Due. Building and wiring: docs/how-to/firmware.md.
//
// What closes a valve, whatever fails:
//   - Its time is over, its command has expired, the computer is silent, a limit is reached: the
//     timer's interrupt closes it within 0.1 ms. It needs nothing of the loop, which may wait
//     for the Wi-Fi shield, or hang in its library, as long as it likes.
//   - The interrupt ceases, as interrupts were left off, or the processor is caught in a fault: the
//     hardware's watchdog, which has a clock of its own and is fed by the interrupt alone, resets
//     the Due within kHardwareWatchdog, and pull-downs at the valves' drivers close all. If
//     the loop still runs, it closes them before, as `poll` does what `tick` does.
//   - The loop hangs: after kPatience the interrupt feeds the watchdog no more, and the Due starts
//     anew, disarmed. The valves have been closed by then for want of commands.
//   - Power fails: the valves are normally closed.

#include <Arduino.h>

#include "base.hpp"
#include "due_base.hpp"
#include "due_computer.hpp"
#include "settings.hpp"

static const uint32_t kHardwareWatchdog = 100;       // below any sensible watchdog time [ms]
static const uint32_t kPatience = 2000;              // with the loop [ms]
static const uint32_t kConnectPatience = 30000;      // with the network [ms]
static const uint32_t kOffline = 10000;              // without it [ms]

static DueBase board;
static COMPUTER computer;
static fss::DueClock the_clock;
static volatile uint32_t alive = 0, patience = kConnectPatience;  // of the loop [ms]

static fss::Base& firmware() {
  static fss::Base base(fss::start_number(), kKey, board, computer, kValveLimits);
  return base;
}

extern "C" void TC3_Handler() {
  TC_GetStatus(TC1, 0);  // which acknowledges the interrupt
  firmware().tick(the_clock.now());
  if (millis() - alive < patience) watchdogReset();
}

// The hardware's watchdog can be set once only, and begins with 16 s: it is set in setup(), where
// the Arduino core would have switched it off before.
void watchdogSetup() {}

void setup() {
  board.begin();
  firmware();  // made before an interrupt may ask for it
  alive = millis();
  board.start_timer();
  watchdogEnable(kHardwareWatchdog);
  while (!computer.connect(WIFI_NETWORK, WIFI_PASSWORD, kPort)) alive = millis();
  alive = millis();
  patience = kPatience;
}

// The Wi-Fi library comes back from a lost network only by steps that take seconds: a start anew is
// simpler, once the board's own watchdog has long disarmed it.
void loop() {
  static uint32_t online = 0, looked = 0;
  alive = millis();
  firmware().poll(the_clock.now());
  if (alive - looked < 1000) return;
  looked = alive;
  if (computer.online()) online = alive;
  if (alive - online > kOffline && !firmware().valves().armed()) NVIC_SystemReset();
}
