// The core at a pipe, for the tests: a request a line on stdin, its answer a line on stdout.
//
//   blake2s KEY DATA SIZE       the digest
//   encode KEY FIELD...         the frame of telemetry with these fields, in their order
//   decode KEY DATA             `command FIELD...`, or why it is none
//   stream FRAME                the bytes that carry a frame on a serial line
//   unstream DATA               the frames in these bytes
//
// Bytes are hexadecimal, `-` for none.

#include <stdio.h>

#include <iostream>
#include <sstream>

#include "frame.hpp"
#include "stream.hpp"
#include "text.hpp"

namespace fss {
namespace {

using Words = std::istringstream;

Bytes bytes(Words& words) {
  std::string word;
  words >> word;
  return from_hex(word);
}

template <typename Integer>
Integer number(Words& words) {
  long long value = 0;
  unsigned long long large = 0;  // of 64 bits
  if constexpr (sizeof(Integer) == 8) {
    words >> large;
    return static_cast<Integer>(large);
  }
  words >> value;
  return static_cast<Integer>(value);
}

std::string digest(Words& words) {
  const Key key = key_of(bytes(words));
  const Bytes data = bytes(words);
  const auto size = number<uint8_t>(words);
  uint8_t out[32];
  blake2s(key, data.data(), data.size(), out, size);
  return to_hex(out, size);
}

std::string encoded(Words& words) {
  const Key key = key_of(bytes(words));
  Telemetry frame;
  frame.link = number<uint8_t>(words);
  frame.flags = number<uint8_t>(words);
  frame.boot = number<uint16_t>(words);
  frame.sequence = number<uint32_t>(words);
  frame.clock = number<uint64_t>(words);
  frame.echo = number<uint32_t>(words);
  frame.turnaround = number<uint32_t>(words);
  frame.position = number<int32_t>(words);
  frame.velocity = number<int32_t>(words);
  frame.current = number<int16_t>(words);
  frame.mode = static_cast<Mode>(number<uint8_t>(words));
  frame.slow_id = static_cast<Slow>(number<uint8_t>(words));
  frame.status = number<uint32_t>(words);
  frame.torque = number<int32_t>(words);
  frame.torque_age = number<uint8_t>(words);
  frame.slow_value = number<int32_t>(words);
  uint8_t data[kFrameSize];
  encode(frame, key, data);
  return to_hex(data, kFrameSize);
}

std::string decoded(Words& words) {
  static const char* const refusals[] = {"",    "length",    "magic", "version", "kind",
                                         "crc", "signature", "field"};
  const Key key = key_of(bytes(words));
  const Bytes data = bytes(words);
  Command command;
  const Refusal refusal = decode(data.data(), data.size(), key, command);
  if (refusal != Refusal::None) return refusals[static_cast<int>(refusal)];
  std::ostringstream out;
  out << "command " << +command.link << ' ' << +command.flags << ' ' << command.boot << ' '
      << command.sequence << ' ' << command.clock << ' ' << command.expiry << ' '
      << static_cast<int>(command.mode) << ' ' << command.watchdog << ' ' << command.set_point
      << ' ' << command.velocity << ' ' << command.acceleration;
  return out.str();
}

std::string streamed(Words& words) {
  Bytes frame = bytes(words);
  frame.resize(kFrameSize);
  uint8_t out[kStreamedSize];
  to_stream(frame.data(), out);
  return to_hex(out, kStreamedSize);
}

std::string found(Words& words) {
  StreamReader reader;
  std::string frames;
  for (const uint8_t byte : bytes(words)) {
    if (const uint8_t* frame = reader.take(byte)) {
      frames += (frames.empty() ? "" : " ") + to_hex(frame, kFrameSize);
    }
  }
  return frames.empty() ? "-" : frames;
}

std::string answer(const std::string& line) {
  Words words(line);
  std::string request;
  words >> request;
  if (request == "blake2s") return digest(words);
  if (request == "encode") return encoded(words);
  if (request == "decode") return decoded(words);
  if (request == "stream") return streamed(words);
  if (request == "unstream") return found(words);
  return "unknown request";
}

}  // namespace
}  // namespace fss

int main() {
  std::string line;
  while (std::getline(std::cin, line)) std::cout << fss::answer(line) << std::endl;
  return 0;
}
