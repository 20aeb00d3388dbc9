#include "frame.hpp"

#include <string.h>

#include "bytes.hpp"

namespace fss {
namespace {

constexpr uint16_t kMagic = 0x4653;
constexpr uint8_t kVersion = 2;
constexpr size_t kCrcAt = 52, kSignatureAt = 56, kSignatureSize = 16;
constexpr uint32_t kShortest = 1000, kLongest = 60000000;  // segments [us]

// CRC-32 as zlib's, four bits at a time.
uint32_t crc32(const uint8_t* data, size_t size) {
  constexpr uint32_t table[16] = {
      0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4,
      0x4DB26158, 0x5005713C, 0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C,
      0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
  uint32_t crc = 0xFFFFFFFF;
  for (size_t i = 0; i < size; ++i) {
    crc ^= data[i];
    crc = crc >> 4 ^ table[crc & 15];
    crc = crc >> 4 ^ table[crc & 15];
  }
  return ~crc;
}

void sign(const uint8_t* data, const Key& key, uint8_t* signature) {
  if (key.size) {
    blake2s(key, data, kSignatureAt, signature, kSignatureSize);
  } else {
    memset(signature, 0, kSignatureSize);
  }
}

// All bytes are compared, so that the time taken does not tell how many were right.
bool signature_fits(const uint8_t* data, const Key& key) {
  uint8_t signature[kSignatureSize];
  sign(data, key, signature);
  uint8_t difference = 0;
  for (size_t i = 0; i < kSignatureSize; ++i) difference |= signature[i] ^ data[kSignatureAt + i];
  return difference == 0;
}

bool is_mode(uint8_t number) {
  switch (static_cast<Mode>(number)) {
    case Mode::Off:
    case Mode::Current:
    case Mode::Velocity:
    case Mode::Position:
    case Mode::Path:
      return true;
  }
  return false;
}

bool has_meaning(const uint8_t* data, const Command& command) {
  const uint8_t flags = command.flags;
  if (command.link == 0 || flags & ~(kArm | kStop | kHold | kClearFaults | kHome)) return false;
  if (!is_mode(data[28]) || data[29] != 0 || command.watchdog == 0) return false;
  if (command.velocity < 0 || command.acceleration < 0) return false;
  const bool numbers = command.set_point >= 1 && command.set_point <= 0xFFFF;
  if (command.mode == Mode::Path && !numbers) return false;
  if (load<uint64_t>(data + 44) != 0) return false;
  if (!(flags & kArm)) return !(flags & kHome);
  return !(flags & kStop) && command.boot != 0 && command.expiry != 0;
}

bool has_meaning(const Segment& segment) {
  if (segment.link == 0 || segment.flags & ~kLast || segment.boot == 0) return false;
  if (segment.path == 0 || segment.index == 0xFFFF) return false;
  if (segment.flags & kLast && segment.end.velocity != 0) return false;
  const uint64_t duration = segment.end.time - segment.begin.time;
  return duration >= kShortest && duration <= kLongest && segment.end.time > segment.begin.time;
}

Command read_command(const uint8_t* data) {
  Command command;
  command.link = data[4];
  command.flags = data[5];
  command.boot = load<uint16_t>(data + 6);
  command.sequence = load<uint32_t>(data + 8);
  command.clock = load<uint64_t>(data + 12);
  command.expiry = load<uint64_t>(data + 20);
  command.mode = static_cast<Mode>(data[28]);
  command.watchdog = load<uint16_t>(data + 30);
  command.set_point = load<int32_t>(data + 32);
  command.velocity = load<int32_t>(data + 36);
  command.acceleration = load<int32_t>(data + 40);
  return command;
}

Segment read_segment(const uint8_t* data) {
  Segment segment;
  segment.link = data[4];
  segment.flags = data[5];
  segment.boot = load<uint16_t>(data + 6);
  segment.sequence = load<uint32_t>(data + 8);
  segment.clock = load<uint64_t>(data + 12);
  segment.path = load<uint16_t>(data + 20);
  segment.index = load<uint16_t>(data + 22);
  segment.begin.time = load<uint64_t>(data + 24);
  segment.end.time = segment.begin.time + load<uint32_t>(data + 32);
  segment.begin.position = load<int32_t>(data + 36);
  segment.begin.velocity = load<int32_t>(data + 40);
  segment.end.position = load<int32_t>(data + 44);
  segment.end.velocity = load<int32_t>(data + 48);
  return segment;
}

}  // namespace

void encode(const Telemetry& frame, const Key& key, uint8_t* data) {
  store(data, kMagic);
  data[2] = kVersion;
  data[3] = static_cast<uint8_t>(Kind::Telemetry);
  data[4] = frame.link;
  data[5] = frame.flags;
  store(data + 6, frame.boot);
  store(data + 8, frame.sequence);
  store(data + 12, frame.clock);
  store(data + 20, frame.echo);
  store(data + 24, frame.turnaround);
  store(data + 28, frame.position);
  store(data + 32, frame.velocity);
  store(data + 36, frame.current);
  data[38] = static_cast<uint8_t>(frame.mode);
  data[39] = static_cast<uint8_t>(frame.slow_id);
  store(data + 40, frame.status);
  store(data + 44, frame.torque, 3);
  data[47] = frame.torque_age;
  store(data + 48, frame.slow_value);
  store(data + kCrcAt, crc32(data, kCrcAt));
  sign(data, key, data + kSignatureAt);
}

Refusal decode(const uint8_t* data, size_t size, const Key& key, Frame& frame) {
  if (size != kFrameSize) return Refusal::Length;
  if (load<uint16_t>(data) != kMagic) return Refusal::Magic;
  if (data[2] != kVersion) return Refusal::Version;
  const auto kind = static_cast<Kind>(data[3]);
  if (kind != Kind::Command && kind != Kind::Segment) return Refusal::Kind;
  if (load<uint32_t>(data + kCrcAt) != crc32(data, kCrcAt)) return Refusal::Crc;
  if (!signature_fits(data, key)) return Refusal::Signature;
  if (kind == Kind::Command) {
    const Command command = read_command(data);
    if (!has_meaning(data, command)) return Refusal::Field;
    frame.command = command;
  } else {
    const Segment segment = read_segment(data);
    if (!has_meaning(segment)) return Refusal::Field;
    frame.segment = segment;
  }
  frame.kind = kind;
  return Refusal::None;
}

}  // namespace fss
