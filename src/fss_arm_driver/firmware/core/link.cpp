#include "link.hpp"

namespace fss {
namespace {

constexpr int kBatch = 8;  // datagrams taken at once, so that a flood cannot keep the drive waiting

int16_t to_16_bits(int32_t value) {
  return static_cast<int16_t>(value < INT16_MIN ? INT16_MIN : value > INT16_MAX ? INT16_MAX : value);
}

Demand demand_of(const Command& command) {
  Demand demand;
  if (command.flags & kHome) {
    demand.goal = Demand::Home;
    return demand;
  }
  demand.set_point = command.set_point;
  switch (command.mode) {
    case Mode::Off:
      return Demand{};
    case Mode::Current:
      demand.goal = Demand::Current;
      return demand;
    case Mode::Velocity:
      demand.goal = Demand::Velocity;
      break;
    case Mode::Position:
      demand.goal = Demand::Position;
      demand.velocity = command.velocity;
      break;
    case Mode::Path:  // the path says, again and again
      return Demand{};
  }
  demand.acceleration = command.acceleration;
  return demand;
}

// Whether a command that arms orders a path to be followed.
bool is_path(const Command& command) {
  return command.mode == Mode::Path && !(command.flags & (kHold | kHome));
}

}  // namespace

void Link::poll(uint64_t now) {
  torque_.poll(board_, now);
  uint8_t datagram[kFrameSize + 1];  // a byte more shows that it is too long
  for (int i = 0; i < kBatch; ++i) {
    const size_t size = computer_.receive(datagram, sizeof datagram);
    if (size == 0) break;
    if (!take(datagram, size, now)) gate_.refuse();
  }
  drive_.listen(now);
  watch(now);
  follow(now);
  drive_.talk(now);
  if (drive_.position_clock() != read_at_) {
    read_at_ = drive_.position_clock();
    echo_ = gate_.echo();
    turnaround_ = gate_.turnaround(now);
  }
  report();
}

uint8_t Link::flags() const {
  return static_cast<uint8_t>((armed_ ? kArmed : 0) | (stopped_ ? kStopped : 0) |
                              (watchdog_ ? kWatchdog : 0) |
                              (drive_.referenced() ? kReferenced : 0) |
                              (paths_.following() ? kFollowing : 0) |
                              (paths_.broken() ? kBroken : 0));
}

// Whether these bytes are a command or a segment that is taken.
bool Link::take(const uint8_t* data, size_t size, uint64_t now) {
  Frame frame;
  if (decode(data, size, key_, frame) != Refusal::None) return false;
  if (frame.kind == Kind::Segment) {
    return armed_ && gate_.is_current(frame.segment) && paths_.take(frame.segment, now);
  }
  if (!gate_.take(frame.command, now)) return false;
  computer_.answer();
  command_ = frame.command;
  obey(command_);
  return true;
}

void Link::obey(const Command& command) {
  if (command.flags & kClearFaults) drive_.clear_faults();
  if (command.flags & kStop) {
    disarm();
    stopped_ = true;
    if (on_) hold();
  } else if (!(command.flags & kArm)) {
    disarm();
    stopped_ = watchdog_ = dropped_ = on_ = false;
    drive_.demand(Demand{});
  } else if (!stopped_ && !watchdog_ && !dropped_) {
    armed_ = on_ = true;
    if (is_path(command)) return;
    paths_.leave();
    if (command.flags & kHold) {
      hold();
    } else {
      drive_.demand(demand_of(command));
    }
  }
}

// What happens without a command: faults, silence, the end of a set-point's time.
void Link::watch(uint64_t now) {
  if (on_ && drive_.let_go()) {
    disarm();
    on_ = false;
    dropped_ = true;
  }
  if (on_ && (!drive_.answers() || drive_.blocked())) {  // one that only holds as well
    disarm();
    on_ = false;
    dropped_ = true;
    drive_.demand(Demand{});
  }
  if (!armed_) return;
  if (gate_.silent(now)) {
    disarm();
    watchdog_ = true;
    hold();
  } else if (command_.expiry < now) {
    paths_.leave();
    hold();
  }
}

void Link::follow(uint64_t now) {
  if (!armed_ || !is_path(command_) || command_.expiry < now || !drive_.is_open(now)) return;
  if (drive_.refuses()) paths_.fail();
  drive_.demand(paths_.demand(now, Drive::kLead, command_, drive_.measured()));
}

void Link::disarm() {
  armed_ = false;
  paths_.clear();
}

void Link::hold() {
  Demand demand;
  demand.goal = Demand::Hold;
  drive_.demand(demand);
}

// Sends the first measurement of each period. A drive that does not answer has none, and the link
// is silent: it would have to make up a position.
void Link::report() {
  const Measurement& measured = drive_.measured();
  if (!drive_.answers() || measured.clock < due_) return;
  due_ = (measured.clock / period_ + 1) * period_;
  Telemetry frame;
  frame.link = number_;
  frame.flags = flags();
  frame.boot = boot_;
  frame.sequence = sequence_;
  frame.clock = measured.clock;
  frame.echo = echo_;
  frame.turnaround = turnaround_;
  frame.position = measured.position;
  frame.velocity = measured.velocity;
  frame.current = to_16_bits(measured.current);
  frame.mode = drive_.mode();
  frame.slow_id = next_slow();
  frame.status = measured.status;
  frame.torque = torque_.counts;
  frame.torque_age = torque_.age(measured.clock);
  frame.slow_value = slow_value(frame.slow_id);
  ++sequence_;
  uint8_t data[kFrameSize];
  encode(frame, key_, data);
  computer_.send(data);
}

// By turns; while a path is held, it every other time.
Slow Link::next_slow() {
  if (!paths_.holds_none() && sequence_ % 2) return Slow::Path;
  return static_cast<Slow>(1 + slow_turn_++ % kSlowFields);
}

int32_t Link::slow_value(Slow slow) const {
  switch (slow) {
    case Slow::Faults: return static_cast<int32_t>(drive_.faults());
    case Slow::Supply: return drive_.supply();
    case Slow::Battery: return board_.battery();
    case Slow::Temperature: return drive_.temperature();
    case Slow::Firmware: return kFirmware;
    case Slow::Homings: return drive_.homings();
    case Slow::Refused: return static_cast<int32_t>(gate_.refused());
    case Slow::Path: return paths_.report();
    case Slow::Serial: return serial_;
  }
  return 0;
}

}  // namespace fss
