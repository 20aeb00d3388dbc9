#include "frame.hpp"

#include <string.h>

#include "bytes.hpp"

namespace fss {
namespace {

constexpr uint16_t kMagic = 0x4653;
constexpr uint8_t kVersion = 2;
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

}  // namespace

void begin_frame(Kind kind, const Header& header, uint8_t* data) {
  memset(data, 0, kFrameSize);
  store(data, kMagic);
  data[2] = kVersion;
  data[3] = static_cast<uint8_t>(kind);
  data[4] = header.link;
  data[5] = header.flags;
  store(data + 6, header.boot);
  store(data + 8, header.sequence);
  store(data + 12, header.clock);
}

void seal_frame(const Key& key, uint8_t* data) {
  store(data + kCrcAt, crc32(data, kCrcAt));
  sign(data, key, data + kSignatureAt);
}

Refusal check_frame(const uint8_t* data, size_t size, const Key& key, Kind first, Kind last) {
  if (size != kFrameSize) return Refusal::Length;
  if (load<uint16_t>(data) != kMagic) return Refusal::Magic;
  if (data[2] != kVersion) return Refusal::Version;
  const auto kind = static_cast<Kind>(data[3]);
  if (kind < first || kind > last) return Refusal::Kind;
  if (load<uint32_t>(data + kCrcAt) != crc32(data, kCrcAt)) return Refusal::Crc;
  return signature_fits(data, key) ? Refusal::None : Refusal::Signature;
}

Header read_header(const uint8_t* data) {
  Header header;
  header.link = data[4];
  header.flags = data[5];
  header.boot = load<uint16_t>(data + 6);
  header.sequence = load<uint32_t>(data + 8);
  header.clock = load<uint64_t>(data + 12);
  return header;
}

bool has_meaning(const Order& order) {
  if (order.watchdog == 0) return false;
  if (!(order.flags & kArm)) return true;
  return !(order.flags & kStop) && order.boot != 0 && order.expiry != 0;
}

}  // namespace fss
