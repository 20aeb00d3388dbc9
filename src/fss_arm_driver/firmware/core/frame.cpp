#include "frame.hpp"

#include <string.h>

#include "bytes.hpp"

namespace fss {
namespace {

constexpr uint16_t kMagic = 0x4653;
constexpr uint8_t kVersion = 1, kTelemetry = 1, kCommand = 2;
constexpr size_t kCrcAt = 52, kSignatureAt = 56, kSignatureSize = 16;

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
  return number == static_cast<uint8_t>(Mode::Off) ||
         number == static_cast<uint8_t>(Mode::Current) ||
         number == static_cast<uint8_t>(Mode::Velocity) ||
         number == static_cast<uint8_t>(Mode::Position);
}

bool has_meaning(const uint8_t* data) {
  const uint8_t flags = data[5];
  if (data[4] == 0 || flags & ~(kArm | kStop | kHold | kClearFaults | kHome)) return false;
  if (!is_mode(data[28]) || data[29] != 0 || load<uint16_t>(data + 30) == 0) return false;
  if (load<int32_t>(data + 36) < 0 || load<int32_t>(data + 40) < 0) return false;
  if (load<uint64_t>(data + 44) != 0) return false;
  if (!(flags & kArm)) return !(flags & kHome);
  return !(flags & kStop) && load<uint16_t>(data + 6) != 0 && load<uint64_t>(data + 20) != 0;
}

}  // namespace

void encode(const Telemetry& frame, const Key& key, uint8_t* data) {
  store(data, kMagic);
  data[2] = kVersion;
  data[3] = kTelemetry;
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

Refusal decode(const uint8_t* data, size_t size, const Key& key, Command& command) {
  if (size != kFrameSize) return Refusal::Length;
  if (load<uint16_t>(data) != kMagic) return Refusal::Magic;
  if (data[2] != kVersion) return Refusal::Version;
  if (data[3] != kCommand) return Refusal::Kind;
  if (load<uint32_t>(data + kCrcAt) != crc32(data, kCrcAt)) return Refusal::Crc;
  if (!signature_fits(data, key)) return Refusal::Signature;
  if (!has_meaning(data)) return Refusal::Field;
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
  return Refusal::None;
}

}  // namespace fss
