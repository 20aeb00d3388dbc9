#include "stream.hpp"

namespace fss {

void to_stream(const uint8_t* frame, uint8_t* out) {
  uint8_t* code = out + 1;  // 1 + the number of bytes up to the zero that it replaces
  out[0] = out[kStreamedSize - 1] = 0;
  *code = 1;
  for (size_t i = 0; i < kFrameSize; ++i) {
    if (frame[i]) {
      out[i + 2] = frame[i];
      ++*code;
    } else {
      code = out + i + 2;
      *code = 1;
    }
  }
}

const uint8_t* StreamReader::take(uint8_t byte) {
  if (byte) {
    if (size_ < sizeof buffer_) buffer_[size_] = byte;
    if (size_ <= sizeof buffer_) ++size_;
    return nullptr;
  }
  const bool complete = size_ == sizeof buffer_;
  size_ = 0;
  return complete && decode() ? buffer_ + 1 : nullptr;
}

bool StreamReader::decode() {
  size_t at = 0;
  while (at < sizeof buffer_) {
    const uint8_t code = buffer_[at];
    buffer_[at] = 0;
    at += code;
  }
  return at == sizeof buffer_;
}

}  // namespace fss
