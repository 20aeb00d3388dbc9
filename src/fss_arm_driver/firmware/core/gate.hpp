// Which commands a board takes: each once, in order and in time.
// See docs/reference/protocol.md, Taking a command.
#pragma once

#include <stdint.h>

#include "frame.hpp"

namespace fss {

class Gate {
 public:
  Gate(uint8_t link, uint16_t boot, bool is_signed)
      : link_(link), boot_(boot), signed_(is_signed) {}

  // Whether an order that came at `now` [us] is taken.
  bool take(const Order& order, uint64_t now);

  // Whether it is for this start of this board, and no recording from before it was last disarmed.
  bool is_current(const Header& header) const;

  void refuse() { ++refused_; }  // counts a refused datagram

  const Order& order() const { return order_; }  // the last one taken
  uint64_t arrival() const { return arrival_; }  // of it [us]
  bool silent(uint64_t now) const;               // none was taken for the watchdog time
  uint32_t echo() const { return static_cast<uint32_t>(order_.clock); }  // 0: none was taken
  uint32_t turnaround(uint64_t now) const;       // since its arrival [us]
  uint32_t taken() const { return taken_; }
  uint32_t refused() const { return refused_; }

 private:
  bool admits(const Order& order, uint64_t now) const;
  bool follows(const Order& order, uint64_t now) const;

  const uint8_t link_;
  const uint16_t boot_;
  const bool signed_;
  Order order_ = {};
  uint64_t arrival_ = 0;
  uint64_t unarmed_ = 0;  // stamp of the last order that did not arm
  uint32_t newest_ = 0;   // sequence
  uint32_t taken_ = 0, refused_ = 0;
};

}  // namespace fss
