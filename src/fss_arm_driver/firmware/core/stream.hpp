// Frames on a serial line: each COBS-encoded (Cheshire & Baker 1999), a zero before and after it.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "frame.hpp"

namespace fss {

constexpr size_t kStreamedSize = kFrameSize + 3;  // the two zeros and COBS's first code

// Writes the kStreamedSize bytes that carry `frame`.
void to_stream(const uint8_t* frame, uint8_t* out);

// Finds the frames in a stream of bytes, whatever lies between them.
class StreamReader {
 public:
  // Takes a byte; returns the 72 bytes of the frame that it completes (valid until the next
  // byte), or nullptr.
  const uint8_t* take(uint8_t byte);

 private:
  bool decode();

  uint8_t buffer_[kFrameSize + 1] = {};
  size_t size_ = 0;  // bytes since the last zero; one more than a frame: too long
};

}  // namespace fss
