// What the fuzzers share: frames sealed by code that is not the core's, a computer that sends them,
// and what makes them random.
#pragma once

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <random>

#include "blake2s.hpp"
#include "bytes.hpp"
#include "computer.hpp"
#include "frame.hpp"
#include "stream.hpp"

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

class Chance {
 protected:
  explicit Chance(uint32_t seed) : random_(seed) {}

  uint32_t any(uint32_t below) { return static_cast<uint32_t>(random_() % below); }

  void noise(uint8_t* data, size_t size) {
    for (size_t i = 0; i < size; ++i) data[i] = static_cast<uint8_t>(random_());
  }

  // Whether anything has changed.
  bool damage(uint8_t* frame, size_t size) {
    Data before;
    memcpy(before, frame, kFrameSize);
    for (uint32_t i = 1 + any(4); i > 0; --i) {
      uint8_t& byte = frame[any(static_cast<uint32_t>(size))];
      constexpr uint8_t extremes[] = {0x00, 0x7F, 0x80, 0xFF};
      byte = any(2) ? extremes[any(4)] : static_cast<uint8_t>(byte ^ 1u << any(8));
    }
    // A sequence number, stamp or path from far ahead, once taken, has all that follow it refused.
    if (any(500)) memcpy(frame + 8, before + 8, before[3] == 3 ? 14 : 12);
    return memcmp(before, frame, kFrameSize) != 0;
  }

  // Delivers the frames found in a piece of a byte stream with noise around one that `fill` makes.
  template <typename Fill, typename Deliver>
  void stream(Fill fill, Deliver deliver) {
    Data frame;
    uint8_t bytes[3 * kStreamedSize];
    noise(bytes, sizeof bytes);
    fill(frame);
    to_stream(frame, bytes + any(2 * kStreamedSize));
    if (any(2)) bytes[any(sizeof bytes)] = static_cast<uint8_t>(any(3));
    const size_t size = any(4) ? sizeof bytes : any(sizeof bytes);
    for (size_t i = 0; i < size; ++i) {
      if (const uint8_t* found = reader_.take(bytes[i])) deliver(found);
    }
  }

  std::mt19937 random_;

 private:
  StreamReader reader_;
};

// Runs `fuzz` from a seed for as many inputs as the command line says, not signed and signed.
template <typename Fuzz>
int fuzz_all(int argc, char** argv, const char* name, Fuzz fuzz) {
  setlinebuf(stdout);  // so that a report comes after what it is about
  const unsigned long long count = argc > 1 ? strtoull(argv[1], nullptr, 10) : 0;
  if (count < 1000) {
    fprintf(stderr, "usage: %s COUNT [SEED], COUNT 1000 or more\n", name);
    return 1;
  }
  const auto seed = static_cast<uint32_t>(argc > 2 ? strtoul(argv[2], nullptr, 10) : 1);
  Key key = {};
  key.size = 16;
  memcpy(key.bytes, "a key of a link.", 16);
  for (const Key& each : {Key{}, key}) fuzz(seed, each, count / 2);
  return 0;
}

}  // namespace fss
