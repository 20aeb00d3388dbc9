// BLAKE2s with a key (RFC 7693): the signature of a frame.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace fss {

// A link's secret. Size 0: there is none, and frames are not signed.
struct Key {
  uint8_t size;  // 16 to 32
  uint8_t bytes[32];
};

// Writes the first `digest_size` (1 to 32) bytes of the digest that was computed for this size.
void blake2s(const Key& key, const uint8_t* data, size_t size, uint8_t* digest,
             uint8_t digest_size);

}  // namespace fss
