// The core at a pipe, for the tests: a request a line on stdin, its answer a line on stdout.
//
//   encode KEY FIELD...         the frame of telemetry with these fields, in their order
//   decode KEY DATA             `command FIELD...`, or why it is none
//   gyro_lines DATA             the samples in what a gyro sends
//
//   start BOOT KEY [LONGEST ALLOWANCE DUTY TOTAL]
//                               the electronics, the hardware behind them; time begins
//   send DATA                   a datagram arrives: `taken` or `refused`
//   flood COUNT                 so many datagrams of one byte arrive at once
//   run TIME                    so much later [us], the frames sent meanwhile
//   hang TIME                   the same while nothing but the timer's interrupt runs
//   valves                      driven, flags, pulse, left [us], opened by the firmware's count [us]
//   opened                      the valves, for how long they really were open [us]
//   fail OPEN CLOSED CUT SHORTED
//                               valves that stick, and whose wires are cut or shorted: bits
//   gyro COUNTS ON | hold ON    what it measures; whether something is in the gripper
//
// Bytes are hexadecimal, `-` for none. Time is simulated: nothing here depends on the machine's.

#include <optional>

#include "base.hpp"
#include "bench_base.hpp"
#include "gyro_line.hpp"
#include "pipe_computer.hpp"
#include "text.hpp"

namespace fss {
namespace {

std::string encoded(Words& words) {
  const Key key = key_of(bytes(words));
  BaseTelemetry frame;
  frame.link = number<uint8_t>(words);
  frame.flags = number<uint8_t>(words);
  frame.boot = number<uint16_t>(words);
  frame.sequence = number<uint32_t>(words);
  frame.clock = number<uint64_t>(words);
  frame.echo = number<uint32_t>(words);
  frame.turnaround = number<uint32_t>(words);
  frame.gyro_sum = number<uint32_t>(words);
  frame.gyro_samples = number<uint16_t>(words);
  frame.valves = number<uint8_t>(words);
  frame.gripper = number<uint8_t>(words);
  frame.pulse = number<uint16_t>(words);
  frame.pulse_age = number<uint16_t>(words);
  frame.slow_id = static_cast<BaseSlow>(number<uint8_t>(words));
  frame.slow_value = number<int32_t>(words);
  uint8_t data[kFrameSize];
  encode(frame, key, data);
  return to_hex(data, kFrameSize);
}

std::string decoded(Words& words) {
  const Key key = key_of(bytes(words));
  const Bytes data = bytes(words);
  BaseCommand command;
  const Refusal refusal = decode(data.data(), data.size(), key, command);
  if (refusal != Refusal::None) return word(refusal);
  std::string text = "command " + joined(command.link, command.flags, command.boot,
                                         command.sequence, command.clock, command.expiry,
                                         command.pulse, command.watchdog);
  for (const uint16_t time : command.on_times) text += " " + joined(time);
  return text + " " + joined(static_cast<int>(command.grip));
}

std::string sampled(Words& words) {
  GyroLine line;
  std::string text;
  int32_t counts;
  for (const uint8_t byte : bytes(words)) {
    if (line.take(static_cast<char>(byte), counts)) text += (text.empty() ? "" : " ") + joined(counts);
  }
  return text.empty() ? "-" : text;
}

// --- the board in simulated time ----------------------------------------------------------------

constexpr uint64_t kStep = 100;  // between two ticks [us]

struct World {
  // Lets time pass, the loop running or not.
  void run(uint64_t time, bool hangs) {
    for (const uint64_t end = now + time; now < end;) {
      now = std::min(end, now + kStep);
      board.pass(now);
      hangs ? base->tick(now) : base->poll(now);
    }
  }

  BenchBase board;
  PipeComputer computer;
  std::optional<Base> base;
  uint64_t now = 0;
};

std::optional<World> world;

std::string start(Words& words) {
  const auto boot = number<uint16_t>(words);
  const Key key = key_of(bytes(words));
  Limits limits = kLimits;
  if (const auto longest = number<uint32_t>(words)) {
    limits.longest = longest;
    limits.allowance = number<uint32_t>(words);
    limits.duty = number<uint8_t>(words);
    limits.total = number<uint32_t>(words);
  }
  world->base.emplace(boot, key, world->board, world->computer, limits);
  return "done";
}

std::string send(Words& words) {
  const uint32_t refused = world->base->gate().refused();
  const Bytes data = bytes(words);
  world->computer.inbox.push_back(data);
  world->base->poll(world->now);
  return !data.empty() && world->base->gate().refused() == refused ? "taken" : "refused";
}

std::string valves() {
  const Valves& valves = world->base->valves();
  std::string text =
      joined(world->board.driven, valves.flags(), valves.pulse(), valves.left());
  for (int i = 0; i < kValves; ++i) text += " " + joined(valves.opened(i));
  return text;
}

std::string opened() {
  std::string text;
  for (const uint64_t time : world->board.opened) text += joined(time) + " ";
  return text;
}

std::string happen(const std::string& what, Words& words) {
  BenchBase& board = world->board;
  if (what == "fail") {
    board.stuck_open = number<uint8_t>(words);
    board.stuck_closed = number<uint8_t>(words);
    board.cut = number<uint8_t>(words);
    board.shorted = number<uint8_t>(words);
  } else if (what == "gyro") {
    board.rate = number<int32_t>(words);
    board.gyro_on = number<int32_t>(words);
  } else if (what == "flood") {
    world->computer.flood = number<uint32_t>(words);
  } else if (what == "hold") {
    board.something = number<int32_t>(words);
  } else {
    return "unknown request";
  }
  return "done";
}

std::string answer(const char* line) {
  Words words(line);
  const std::string request = words.next();
  if (request == "encode") return encoded(words);
  if (request == "decode") return decoded(words);
  if (request == "gyro_lines") return sampled(words);
  if (request == "start") {
    world.emplace();
    return start(words);
  }
  if (!world) return "nothing was started";
  if (request == "send") return send(words);
  if (request == "run" || request == "hang") {
    world->run(number<uint64_t>(words), request == "hang");
    return world->computer.take_sent();
  }
  if (request == "valves") return valves();
  if (request == "opened") return opened();
  return happen(request, words);
}

}  // namespace
}  // namespace fss

int main() {
  fss::converse(fss::answer);
  return 0;
}
