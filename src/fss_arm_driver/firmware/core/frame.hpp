// Common parts of all frames of docs/reference/protocol.md: start and end.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "blake2s.hpp"

namespace fss {

constexpr size_t kFrameSize = 72;

enum class Kind : uint8_t { Telemetry = 1, Command, Segment, BaseTelemetry, BaseCommand };

// Flags of telemetry that all boards have.
constexpr uint8_t kArmed = 1, kStopped = 2, kWatchdog = 4;

// Flags of commands to any board.
constexpr uint8_t kArm = 1, kStop = 2;

struct Header {
  uint8_t link;       // 0: the base's board
  uint8_t flags;
  uint16_t boot;
  uint32_t sequence;
  uint64_t clock;     // telemetry: at the measurement [us since the start]; else the computer's stamp
};

// What a command says to any board.
struct Order : Header {
  uint64_t expiry;    // in the board's clock [us]; 0: none
  uint16_t watchdog;  // [ms]
};

// Why bytes are not a frame for a board, in the order of the checks.
enum class Refusal : uint8_t { None, Length, Magic, Version, Kind, Crc, Signature, Field };

// Writes the start of a frame, followed by zeros.
void begin_frame(Kind kind, const Header& header, uint8_t* data);

// Writes the end of a frame, signed if there is a key.
void seal_frame(const Key& key, uint8_t* data);

// Checks that these bytes are a complete frame of a kind from `first` to `last`, not its fields.
Refusal check_frame(const uint8_t* data, size_t size, const Key& key, Kind first, Kind last);

Header read_header(const uint8_t* data);

// Whether arming, stopping, expiry and watchdog go together.
bool has_meaning(const Order& order);

// Whether a number comes after another of the same size, modulo that.
template <typename Unsigned>
bool newer(Unsigned number, Unsigned than) {
  const auto ahead = static_cast<Unsigned>(number - than);
  return ahead != 0 && ahead <= static_cast<Unsigned>(~Unsigned{0}) / 2;
}

}  // namespace fss
