#include "link_frame.hpp"

#include "bytes.hpp"

namespace fss {
namespace {

constexpr uint32_t kShortest = 1000, kLongest = 60000000;  // segments [us]

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
  if (!is_mode(data[28]) || data[29] != 0) return false;
  if (command.velocity < 0 || command.acceleration < 0) return false;
  const bool numbers = command.set_point >= 1 && command.set_point <= 0xFFFF;
  if (command.mode == Mode::Path && !numbers) return false;
  if (load<uint64_t>(data + 44) != 0) return false;
  return has_meaning(command) && (flags & kArm || !(flags & kHome));
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
  static_cast<Header&>(command) = read_header(data);
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
  static_cast<Header&>(segment) = read_header(data);
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
  begin_frame(Kind::Telemetry, frame, data);
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
  seal_frame(key, data);
}

Refusal decode(const uint8_t* data, size_t size, const Key& key, Frame& frame) {
  const Refusal refusal = check_frame(data, size, key, Kind::Command, Kind::Segment);
  if (refusal != Refusal::None) return refusal;
  const auto kind = static_cast<Kind>(data[3]);
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
