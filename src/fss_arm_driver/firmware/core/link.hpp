// One link's electronics: commands and paths in, telemetry and the drive's orders out.
// See docs/reference/protocol.md, The link.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "board.hpp"
#include "computer.hpp"
#include "drive.hpp"
#include "gate.hpp"
#include "path.hpp"
#include "torque.hpp"

namespace fss {

constexpr int32_t kFirmware = 0x020100;  // 2.1.0
constexpr uint32_t kPeriod = 200000;    // of telemetry [us]

class Link {
 public:
  // `number` of the link, 1 beside the base; `boot` not as at the last start, never 0; `serial` of
  // the physical link, wherever it is mounted, 0: it has none.
  Link(uint8_t number, uint16_t boot, const Key& key, Board& board, Computer& computer,
       int32_t serial = 0, uint32_t period = kPeriod)
      : number_(number), boot_(boot), key_(key), serial_(serial), period_(period),
        board_(board),
        computer_(computer), drive_(board),
        gate_(number, boot, key.size != 0) {}

  // To be called without pause; `now` is the time since the start [us].
  void poll(uint64_t now);

  uint8_t flags() const;
  const Gate& gate() const { return gate_; }
  const Command& command() const { return command_; }  // the last one taken
  const Drive& drive() const { return drive_; }
  const Follower& paths() const { return paths_; }

 private:
  bool take(const uint8_t* data, size_t size, uint64_t now);
  void obey(const Command& command);
  void watch(uint64_t now);
  void follow(uint64_t now);
  void disarm();
  void hold();
  void report();
  Slow next_slow();
  int32_t slow_value(Slow slow) const;

  const uint8_t number_;
  const uint16_t boot_;
  const Key key_;
  const int32_t serial_;
  const uint32_t period_;
  Board& board_;
  Computer& computer_;
  Drive drive_;
  Gate gate_;
  Command command_ = {};
  Follower paths_;
  Torque torque_;
  bool armed_ = false;
  bool stopped_ = false, watchdog_ = false, dropped_ = false;  // prevent arming until disarmed
  bool on_ = false;  // the drive, from arming on: no stop switches it on

  // Time of the position's reading, and the echo at that time.
  uint64_t read_at_ = 0;
  uint32_t echo_ = 0, turnaround_ = 0;

  uint64_t due_ = 0;       // the next frame
  uint32_t sequence_ = 0;  // of it
  uint8_t slow_turn_ = 0;
};

}  // namespace fss
