// Little-endian integers in a buffer, whatever the machine's own order and alignment.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace fss {

template <typename Integer>
Integer load(const uint8_t* at, size_t size = sizeof(Integer)) {
  uint64_t value = 0;
  for (size_t i = size; i-- > 0;) value = value << 8 | at[i];
  return static_cast<Integer>(value);
}

template <typename Integer>
void store(uint8_t* at, Integer integer, size_t size = sizeof(Integer)) {
  const auto value = static_cast<uint64_t>(integer);
  for (size_t i = 0; i < size; ++i) at[i] = static_cast<uint8_t>(value >> 8 * i);
}

}  // namespace fss
