// Words and hexadecimal bytes, for the host's programs.
#pragma once

#include <stdint.h>

#include <string>
#include <vector>

#include "blake2s.hpp"

namespace fss {

using Bytes = std::vector<uint8_t>;

// Of bytes in hexadecimal; "-" for none.
Bytes from_hex(const std::string& text);
std::string to_hex(const uint8_t* data, size_t size);

// The words of a line, one after the other; empty ones at its end.
class Words {
 public:
  explicit Words(const char* line) : at_(line) {}
  std::string next();

 private:
  const char* at_;
};

// Of 16 to 32 bytes, or none. Exits with a message if there are others.
Key key_of(const Bytes& bytes);

}  // namespace fss
