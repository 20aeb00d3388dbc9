// What the fuzzers share: frames sealed by code that is not the core's, and a computer that sends them.
#pragma once

#include <stdint.h>
#include <string.h>

#include <algorithm>

#include "blake2s.hpp"
#include "bytes.hpp"
#include "computer.hpp"
#include "frame.hpp"

namespace fss {

using Data = uint8_t[kFrameSize];

inline uint32_t crc32(const uint8_t* data, size_t size) {
  uint32_t crc = 0xFFFFFFFF;
  for (size_t i = 0; i < 8 * size; ++i) {
    const bool odd = (crc ^ static_cast<uint32_t>(data[i / 8] >> i % 8)) & 1;
    crc = crc >> 1 ^ (odd ? 0xEDB88320 : 0);
  }
  return ~crc;
}

inline void seal(uint8_t* frame, const Key& key) {
  store(frame + 52, crc32(frame, 52));
  memset(frame + 56, 0, 16);
  if (key.size) blake2s(key, frame, 56, frame + 56, 16);
}

class FuzzComputer : public Computer {
 public:
  explicit FuzzComputer(Kind telemetry) : telemetry_(telemetry) {}

  size_t receive(uint8_t* data, size_t room) override {
    const size_t size = std::min(room, size_);
    memcpy(data, datagram_, size);
    size_ = 0;
    return size;
  }
  void answer() override {}
  void send(const uint8_t* frame) override {
    memcpy(last, frame, kFrameSize);
    ++sent[frame[3] == static_cast<uint8_t>(telemetry_)];
  }

  void put(const uint8_t* data, size_t size) {
    size_ = std::min(size, sizeof datagram_);
    memcpy(datagram_, data, size_);
  }

  unsigned long long sent[2] = {};  // what is not telemetry, and what is
  Data last = {};

 private:
  const Kind telemetry_;
  uint8_t datagram_[100] = {};
  size_t size_ = 0;
};

}  // namespace fss
