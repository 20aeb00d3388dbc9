// What the core needs of the connection to the computer. Nothing here may block.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace fss {

class Computer {
 public:
  // `receive` gives the next frame, cut to `room`, and its size, 0 if none has come; `answer` has
  // `send` send to where that one came from, from now on.
  virtual size_t receive(uint8_t* data, size_t room) = 0;
  virtual void answer() = 0;
  virtual void send(const uint8_t* frame) = 0;

 protected:
  ~Computer() = default;
};

}  // namespace fss
