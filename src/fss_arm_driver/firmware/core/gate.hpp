// Which commands a link takes: each once, in order and in time.
// See docs/reference/protocol.md, Taking a command.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frame.hpp"

namespace fss {

class Gate {
 public:
  Gate(uint8_t link, uint16_t boot, const Key& key) : link_(link), boot_(boot), key_(key) {}

  // Whether these bytes, come at `now` [us], are a command to take: then it is `command`.
  bool take(const uint8_t* data, size_t size, uint64_t now);

  const Command& command() const { return command_; }  // the last one taken
  uint64_t arrival() const { return arrival_; }        // of it [us]
  bool silent(uint64_t now) const;                     // none was taken for the watchdog time
  uint32_t taken() const { return taken_; }
  uint32_t refused() const { return refused_; }

 private:
  bool admits(const Command& command, uint64_t now) const;
  bool follows(const Command& command, uint64_t now) const;

  const uint8_t link_;
  const uint16_t boot_;
  const Key key_;
  Command command_ = {};
  uint64_t arrival_ = 0;
  uint64_t latest_ = 0;   // stamp of the computer
  uint32_t newest_ = 0;   // sequence
  uint32_t taken_ = 0, refused_ = 0;
};

}  // namespace fss
