#include "base_frame.hpp"

#include "bytes.hpp"

namespace fss {
namespace {

bool has_meaning(const uint8_t* data, const BaseCommand& command) {
  if (command.link != kBoard || command.flags & ~(kArm | kStop)) return false;
  if (command.grip > Grip::Close || load<uint32_t>(data + 49, 3) != 0) return false;
  uint16_t any = 0;
  for (const uint16_t time : command.on_times) any |= time;
  if (any != 0 && command.pulse == 0) return false;
  const bool idle = command.pulse == 0 && command.grip == Grip::Keep;
  return has_meaning(command) && (command.flags & kArm || idle);
}

}  // namespace

void encode(const BaseTelemetry& frame, const Key& key, uint8_t* data) {
  begin_frame(Kind::BaseTelemetry, frame, data);
  store(data + 20, frame.echo);
  store(data + 24, frame.turnaround);
  store(data + 28, frame.gyro_sum);
  store(data + 32, frame.gyro_samples);
  data[34] = frame.valves;
  data[35] = frame.gripper;
  store(data + 36, frame.pulse);
  store(data + 38, frame.pulse_age);
  data[40] = static_cast<uint8_t>(frame.slow_id);
  store(data + 44, frame.slow_value);
  seal_frame(key, data);
}

Refusal decode(const uint8_t* data, size_t size, const Key& key, BaseCommand& command) {
  const Refusal refusal = check_frame(data, size, key, Kind::BaseCommand, Kind::BaseCommand);
  if (refusal != Refusal::None) return refusal;
  BaseCommand read;
  static_cast<Header&>(read) = read_header(data);
  read.expiry = load<uint64_t>(data + 20);
  read.pulse = load<uint16_t>(data + 28);
  read.watchdog = load<uint16_t>(data + 30);
  for (size_t i = 0; i < kValves; ++i) read.on_times[i] = load<uint16_t>(data + 32 + 2 * i);
  read.grip = static_cast<Grip>(data[48]);
  if (!has_meaning(data, read)) return Refusal::Field;
  command = read;
  return Refusal::None;
}

}  // namespace fss
