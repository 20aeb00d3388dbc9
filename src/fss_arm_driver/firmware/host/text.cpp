#include "text.hpp"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

namespace fss {

Bytes from_hex(const std::string& text) {
  Bytes bytes;
  for (size_t i = 0; text != "-" && i + 1 < text.size(); i += 2) {
    bytes.push_back(static_cast<uint8_t>(strtoul(text.substr(i, 2).c_str(), nullptr, 16)));
  }
  return bytes;
}

std::string to_hex(const uint8_t* data, size_t size) {
  std::string text;
  for (size_t i = 0; i < size; ++i) {
    text += "0123456789abcdef"[data[i] >> 4];
    text += "0123456789abcdef"[data[i] & 15];
  }
  return text.empty() ? "-" : text;
}

std::string Words::next() {
  at_ += strspn(at_, " \r\n");
  const size_t size = strcspn(at_, " \r\n");
  at_ += size;
  return {at_ - size, size};
}

Key key_of(const Bytes& bytes) {
  Key key = {};
  if (!bytes.empty() && (bytes.size() < 16 || bytes.size() > sizeof key.bytes)) {
    fprintf(stderr, "a key of %zu bytes, expected 16 to 32\n", bytes.size());
    exit(1);
  }
  key.size = static_cast<uint8_t>(bytes.size());
  if (key.size) memcpy(key.bytes, bytes.data(), key.size);
  return key;
}

}  // namespace fss
