// Which commands a link takes: each once, in order and in time; and which segments.
// See docs/reference/protocol.md, Taking a command and Following a path.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frame.hpp"
#include "path.hpp"

namespace fss {

enum class Taken : uint8_t { Nothing, Command, Segment };

class Gate {
 public:
  Gate(uint8_t link, uint16_t boot, const Key& key) : link_(link), boot_(boot), key_(key) {}

  // What is taken of these bytes, come at `now` [us]: a command, which is `command` from now on, or
  // a segment, which `paths` keep; they are nullptr while the link is not armed.
  Taken take(const uint8_t* data, size_t size, uint64_t now, Follower* paths);

  const Command& command() const { return command_; }  // the last one taken
  uint64_t arrival() const { return arrival_; }        // of it [us]
  bool silent(uint64_t now) const;                     // none was taken for the watchdog time
  uint32_t taken() const { return taken_; }            // commands
  uint32_t refused() const { return refused_; }

 private:
  Taken take(const Frame& frame, uint64_t now, Follower* paths);
  bool admits(const Command& command, uint64_t now) const;
  bool follows(const Command& command, uint64_t now) const;

  const uint8_t link_;
  const uint16_t boot_;
  const Key key_;
  Command command_ = {};
  uint64_t arrival_ = 0;
  uint64_t latest_ = 0;   // stamp of the computer
  uint64_t unarmed_ = 0;  // likewise, of the last command that did not arm
  uint32_t newest_ = 0;   // sequence
  uint32_t taken_ = 0, refused_ = 0;
};

}  // namespace fss
