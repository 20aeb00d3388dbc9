// The core at a pipe, for the tests: a request a line on stdin, its answer a line on stdout.
//
//   blake2s KEY DATA SIZE       the digest
//   encode KEY FIELD...         the frame of telemetry with these fields, in their order
//   decode KEY DATA             `command FIELD...` or `segment FIELD...`, or why it is neither
//   stream FRAME                the bytes that carry a frame on a serial line
//   unstream DATA               the frames in these bytes
//
//   paths                       none are held
//   keep SEGMENT TIME           a segment comes: `taken` or `refused`
//   follow NUMBER MOST TIME LEAD POSITION VELOCITY
//                               what the drive shall have: `hold` or its velocity; following,
//                               broken, and the slow field
//   leave                       the path followed
//
//   start LINK BOOT KEY SERIAL  a link's electronics with a drive behind them; time begins
//   restart LINK BOOT KEY SERIAL
//                               the electronics alone
//   drive                       a drive alone; time begins
//   line DATA BAUD TIME         bytes for the drive at this rate; its answers within the time [us]
//   send DATA                   a datagram arrives: `taken` or `refused`
//   flood COUNT                 so many datagrams of one byte arrive at once
//   run TIME                    so much later [us], the frames sent meanwhile
//   orders                      what the drive was told since the last call, but for readings
//   joint                       position [counts], velocity [counts/s], mode and baud of the drive
//   torque COUNTS | push VELOCITY | reference 0 or 1 | plug 0 or 1 | power | off |
//   noise DATA | status BITS | faults BITS | lack VARIABLE | shake 0 or 1 |
//   delay TIME | fail CODE
//                               what may happen to the drive; the last: its next order fails
//
// Bytes are hexadecimal, `-` for none. Time is simulated: nothing here depends on the machine's.

#include <optional>

#include "bench_board.hpp"
#include "link.hpp"
#include "path.hpp"
#include "pipe_computer.hpp"
#include "stream.hpp"
#include "text.hpp"

namespace fss {
namespace {

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
  const Key key = key_of(bytes(words));
  const Bytes data = bytes(words);
  Frame frame;
  const Refusal refusal = decode(data.data(), data.size(), key, frame);
  if (refusal != Refusal::None) return word(refusal);
  if (frame.kind == Kind::Segment) {
    const Segment& segment = frame.segment;
    const Knot &begin = segment.begin, &end = segment.end;
    return "segment " + joined(segment.link, segment.flags, segment.boot, segment.sequence,
                               segment.clock, segment.path, segment.index, begin.time,
                               end.time - begin.time, begin.position, begin.velocity,
                               end.position, end.velocity);
  }
  const Command& command = frame.command;
  return "command " + joined(command.link, command.flags, command.boot, command.sequence,
                             command.clock, command.expiry, static_cast<int>(command.mode),
                             command.watchdog, command.set_point, command.velocity,
                             command.acceleration);
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
      frames += to_hex(frame, kFrameSize);
    }
  }
  return frames.empty() ? "-" : frames;
}

// --- paths --------------------------------------------------------------------------------------

Follower paths;

std::string keep(Words& words) {
  Frame frame;
  const Bytes data = bytes(words);
  const auto time = number<uint64_t>(words);
  if (decode(data.data(), data.size(), Key{}, frame) != Refusal::None) return "no frame";
  return frame.kind == Kind::Segment && paths.take(frame.segment, time) ? "taken" : "refused";
}

std::string follow(Words& words) {
  Command command = {};
  Measurement measured;
  command.set_point = number<int32_t>(words);
  command.velocity = number<int32_t>(words);
  measured.clock = number<uint64_t>(words);
  const auto lead = number<uint32_t>(words);
  measured.position = number<int32_t>(words);
  measured.velocity = number<int32_t>(words);
  const Demand demand = paths.demand(measured.clock, lead, command, measured);
  return (demand.goal == Demand::Hold ? "hold" : joined(demand.set_point)) + " " +
         joined(paths.following(), paths.broken(), paths.report());
}

std::string leave() {
  paths.leave();
  return "done";
}

// --- a link in simulated time -------------------------------------------------------------------

constexpr uint64_t kStep = 100;  // between two polls [us]

struct World {
  void poll() {
    board.pass(now);
    link->poll(now);
  }

  BenchBoard board;
  PipeComputer computer;
  std::optional<Link> link;
  uint64_t now = 0;
};

std::optional<World> world;

std::string start(Words& words) {
  const auto link = number<uint8_t>(words);
  const auto boot = number<uint16_t>(words);
  const Key key = key_of(bytes(words));
  world->link.emplace(link, boot, key, world->board, world->computer, number<int32_t>(words));
  return "done";
}

std::string send(Words& words) {
  const uint32_t refused = world->link->gate().refused();
  const Bytes data = bytes(words);
  world->computer.inbox.push_back(data);
  world->poll();
  return !data.empty() && world->link->gate().refused() == refused ? "taken" : "refused";
}

std::string run(Words& words) {
  const uint64_t end = world->now + number<uint64_t>(words);
  for (; world->now < end; world->now += kStep) world->poll();
  return world->computer.take_sent();
}

std::string exchange(Words& words) {
  DriveModel& drive = world->board.drive();
  const Bytes data = bytes(words);
  drive.set_baud(number<uint32_t>(words), world->now);
  drive.write(data.data(), data.size(), world->now);
  world->now += number<uint64_t>(words);
  uint8_t answer[1000];
  const size_t size = drive.read(answer, sizeof answer, world->now);
  return size ? to_hex(answer, size) : "-";
}

std::string joint() {
  const DriveModel& drive = world->board.drive();
  return joined(drive.position(), drive.velocity(), drive.mode(), drive.baud());
}

std::string happen(const std::string& what, Words& words) {
  DriveModel& drive = world->board.drive();
  if (what == "torque") world->board.torque = number<int32_t>(words);
  else if (what == "push") drive.push(number<int32_t>(words));
  else if (what == "reference") drive.reference(number<int32_t>(words));
  else if (what == "plug") drive.plug(number<int32_t>(words));
  else if (what == "power") drive.power_cycle();
  else if (what == "off") drive.switch_off();
  else if (what == "noise") drive.noise(bytes(words), world->now);
  else if (what == "status") drive.report(number<uint32_t>(words));
  else if (what == "faults") drive.latch_faults(number<uint32_t>(words));
  else if (what == "lack") drive.lack(number<uint8_t>(words));
  else if (what == "shake") drive.shake(number<int32_t>(words));
  else if (what == "delay") drive.delay(number<uint64_t>(words));
  else if (what == "fail") drive.fail_next(number<int32_t>(words));
  else if (what == "flood") world->computer.flood = number<uint32_t>(words);
  else return "unknown request";
  return "done";
}

std::string answer(const char* line) {
  Words words(line);
  const std::string request = words.next();
  if (request == "blake2s") return digest(words);
  if (request == "encode") return encoded(words);
  if (request == "decode") return decoded(words);
  if (request == "stream") return streamed(words);
  if (request == "unstream") return found(words);
  if (request == "paths") paths.clear();
  if (request == "paths" || request == "leave") return leave();
  if (request == "keep") return keep(words);
  if (request == "follow") return follow(words);
  if (request == "start") world.emplace();
  if (request == "start" || (request == "restart" && world)) return start(words);
  if (request == "drive") {
    world.emplace();
    return "done";
  }
  if (!world) return "nothing was started";
  if (request == "send") return send(words);
  if (request == "run") return run(words);
  if (request == "orders") return world->board.drive().take_orders();
  if (request == "joint") return joint();
  if (request == "line") return exchange(words);
  return happen(request, words);
}

}  // namespace
}  // namespace fss

int main() {
  fss::converse(fss::answer);
  return 0;
}
