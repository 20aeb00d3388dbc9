// Words, numbers and hexadecimal bytes, for the host's programs.
#pragma once

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <string>
#include <vector>

#include "frame.hpp"

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

// The next word as bytes or as a number.
inline Bytes bytes(Words& words) { return from_hex(words.next()); }

template <typename Integer>
Integer number(Words& words) {
  const std::string word = words.next();
  const bool negative = word[0] == '-';
  return negative ? static_cast<Integer>(strtoll(word.c_str(), nullptr, 10))
                  : static_cast<Integer>(strtoull(word.c_str(), nullptr, 10));
}

template <typename... Integers>
std::string joined(Integers... integers) {
  std::string text;
  ((text += (text.empty() ? "" : " ") + std::to_string(integers)), ...);
  return text;
}

// Answers each line of stdin with one on stdout.
template <typename Answer>
void converse(Answer answer) {
  char line[4096];
  while (fgets(line, sizeof line, stdin)) {
    printf("%s\n", std::string(answer(line)).c_str());
    fflush(stdout);
  }
}

// What is refused for which reason, as words.
inline const char* word(Refusal refusal) {
  static const char* const words[] = {"",    "length",    "magic", "version", "kind",
                                      "crc", "signature", "field"};
  return words[static_cast<int>(refusal)];
}

// Of 16 to 32 bytes, or none. Exits with a message if there are others.
Key key_of(const Bytes& bytes);

}  // namespace fss
