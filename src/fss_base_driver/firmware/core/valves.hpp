// The eight valves: which are open, until when, and whether they may be at all.
// See docs/reference/base_protocol.md, The board.
//
// All arithmetic is integer and exact in time, however often it is called.
// fss_base_driver.protocol.BoardState is the same table in Python.
#pragma once

#include <stdint.h>

#include "base_frame.hpp"

namespace fss {

// The board's own limits, which no frame changes.
struct Limits {
  uint32_t longest;    // pulse [us]
  uint32_t allowance;  // of open time of a valve, full at the start [us]
  uint8_t duty;        // at which that fills again [%]
  uint32_t total;      // of all valves since the last order to disarm [us]
};
constexpr Limits kLimits = {1000000, 5000000, 50, 300000000};

class Valves {
 public:
  explicit Valves(const Limits& limits);

  // Lets time pass until `now` [us]; nothing, if that is over. Short: it runs in an interrupt.
  void tick(uint64_t now);

  // Executes a command accepted at the present time.
  void obey(const BaseCommand& command);

  uint64_t clock() const { return clock_; }  // the time that it knows [us]
  bool armed() const { return armed_; }
  uint8_t flags() const;
  uint8_t open() const { return open_; }     // bit i - 1: valve i
  uint16_t pulse() const { return pulse_; }  // the one begun last
  uint16_t pulse_age() const;
  uint32_t left() const { return left_; }    // of the total time [us]
  uint64_t opened(int valve) const { return opened_[valve]; }  // since the start; 0 to 7 [us]

 private:
  void begin(const BaseCommand& command);
  bool changes_by(uint64_t time) const;
  uint64_t next() const;
  void pass(uint64_t time);
  void settle();
  void disarm();
  void close();

  const Limits limits_;
  uint64_t clock_ = 0;
  bool armed_ = false;
  bool stopped_ = false, watchdog_ = false, limited_ = false, spent_ = false;
  uint8_t open_ = 0, count_ = 0;          // which, and how many
  uint16_t pulse_ = 0;
  uint64_t begun_ = 0;                    // when the last pulse was
  uint64_t expiry_ = 0, silent_from_ = 0; // the last times at which the last command holds
  uint64_t until_[kValves] = {};          // each is open up to then
  int64_t allowance_[kValves];            // [us / 100]
  uint32_t left_;
  uint64_t opened_[kValves] = {};
};

}  // namespace fss
