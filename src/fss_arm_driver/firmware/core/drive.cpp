#include "drive.hpp"

#include <string.h>

namespace fss {
namespace {

// Variables of the drive.
constexpr uint8_t kTrajectory = 0x00, kCommandedCurrent = 0x02, kCurrent = 0x0c, kVelocity = 0x18,
                  kSupply = 0x1e, kTemperature = 0x20, kDesiredState = 0x24,
                  kCommandedVelocity = 0x2f, kPosition = 0x32, kAccelerationLimit = 0x36,
                  kDecelerationLimit = 0x37, kRate = 0x90, kStatus = 0xa0, kFaults = 0xa4,
                  kProfileType = 0xc8, kTrajectoryStatus = 0xc9, kTarget = 0xca,
                  kProfileVelocity = 0xcb, kProfileAcceleration = 0xcc, kProfileDeceleration = 0xcd,
                  kAbortDeceleration = 0xcf;

// A round of readings. It ends with one whose answer is known: a line too many or too few would have
// shifted all others.
constexpr uint8_t kRound[] = {kPosition,         kVelocity,     kCurrent, kStatus,
                              kTrajectoryStatus, kDesiredState, 0,        kRate};
constexpr uint8_t kSlowTurn = 6;  // where these take turns
// The first is known before the first order, to brake a joint that is found in motion.
constexpr uint8_t kSlowReadings[] = {kAbortDeceleration, kFaults, kSupply, kTemperature};

// Status bits that block motion (docs/reference/faults.md): short, heat, supply, feedback, phasing, the
// enable input, tracking, latched faults.
constexpr uint32_t kBlocking = 0x7F | 1u << 11 | 1u << 18 | 1u << 22;

constexpr uint32_t kReset = 1u << 20;  // of the status: since some time, but just now when it rises

constexpr int32_t kReferencedBit = 1 << 12, kHomingBit = 1 << 13;  // of the trajectory status

constexpr uint64_t kPatience = 3000000;  // with a joint that does not come to rest [us]
constexpr int32_t kAbort = 0, kStart = 1, kFindHome = 2;

constexpr uint32_t kFirstBaud = 9600, kBaud = 115200;
constexpr uint64_t kReplyTime = 100000;  // at most [us]
constexpr uint64_t kResyncTime = 20000;  // for late bytes after a failure
constexpr uint64_t kClearTime = 50000;   // for the answer to an incomplete line
constexpr uint64_t kRateTime = 30000;    // for `s r0x90 115200` to be sent at 9600 baud
constexpr uint64_t kSwitchTime = 100000; // the drive's own, to change its rate
constexpr uint64_t kGone = 500000;       // without a measurement: it does not answer
constexpr uint64_t kBetween = 10000;     // the last order and a new set-point for the same goal

Mode mode_of(Demand::Goal goal) {
  switch (goal) {
    case Demand::Current: return Mode::Current;
    case Demand::Velocity: return Mode::Velocity;
    case Demand::Hold:
    case Demand::Home:
    case Demand::Position: return Mode::Position;
    default: return Mode::Off;
  }
}

// An acceleration [10 counts/s^2] as velocity mode has it [1000 counts/s^2].
int32_t to_limit(int32_t acceleration) { return acceleration < 100 ? 1 : acceleration / 100; }

// A line to the drive.
struct Line {
  char text[24];
  size_t size = 0;

  void add(const char* word) {
    while (*word) text[size++] = *word++;
  }
  void add_variable(uint8_t variable) {
    add(" r0x");
    text[size++] = "0123456789abcdef"[variable >> 4];
    text[size++] = "0123456789abcdef"[variable & 15];
  }
  void add(int32_t number) {
    char digits[10];
    size_t count = 0;
    auto rest = static_cast<uint32_t>(number);
    text[size++] = ' ';
    if (number < 0) {
      text[size++] = '-';
      rest = 0u - rest;
    }
    do digits[count++] = static_cast<char>('0' + rest % 10);
    while (rest /= 10);
    while (count > 0) text[size++] = digits[--count];
  }
};

// A decimal number of 32 bits, signed or not, at the end of a line.
bool parse(const char* text, int32_t& number) {
  const bool negative = *text == '-';
  uint64_t value = 0;
  text += negative;
  if (!*text) return false;
  for (; *text; ++text) {
    if (*text < '0' || *text > '9' || value > 0xFFFFFFFF) return false;
    value = 10 * value + static_cast<uint64_t>(*text - '0');
  }
  if (value > (negative ? 0x80000000u : 0xFFFFFFFFu)) return false;
  number = static_cast<int32_t>(negative ? 0u - static_cast<uint32_t>(value)
                                         : static_cast<uint32_t>(value));
  return true;
}

}  // namespace

void Drive::listen(uint64_t now) {
  receive(now);
  if (waiting_ != Waiting::Nothing && now - asked_at_ > kReplyTime) fail(now);
  if (phase_ == Phase::Running && now - alive_ > kGone) phase_ = Phase::Begin;
}

bool Drive::is_open(uint64_t now) const {
  return waiting_ == Waiting::Nothing && now >= quiet_until_ && now - ordered_at_ >= kBetween;
}

void Drive::talk(uint64_t now) {
  if (waiting_ != Waiting::Nothing || now < quiet_until_) return;
  if (phase_ != Phase::Running) {
    connect(now);
    return;
  }
  if (pending_ && done_ && is_open(now)) begin(asked_);
  if (!order_next(now)) read_next(now);
}

void Drive::demand(const Demand& demand) {
  if (demand == asked_ && !refused_) return;
  asked_ = demand;
  refused_ = false;
  if (demand.goal != demand_.goal) {
    begin(demand);
  } else {
    pending_ = true;  // a new set-point waits its turn, be they ever so many
  }
}

void Drive::begin(const Demand& demand) {
  const bool holds = demand_.goal == Demand::Hold && done_;
  braked_ = holds && demand.goal == Demand::Velocity;
  demand_ = demand;
  outdated_ = true;
  pending_ = done_ = false;
  step_ = 0;
}

bool Drive::blocked() const { return measured_.status & kBlocking; }

bool Drive::at_rest() const {
  return measured_.clock > braked_at_ && measured_.at_rest();
}

// --- replies ------------------------------------------------------------------------------------

void Drive::receive(uint64_t now) {
  uint8_t bytes[32];
  const size_t size = board_.read(bytes, sizeof bytes);
  for (size_t i = 0; i < size; ++i) {
    if (waiting_ == Waiting::Nothing || now < quiet_until_) continue;
    if (line_size_ == 0 && variable_ == kPosition) position_clock_ = now;
    if (bytes[i] == '\r') {
      line_[line_size_] = 0;
      reply(now);
      line_size_ = 0;
    } else if (line_size_ < sizeof line_ - 1) {
      line_[line_size_++] = static_cast<char>(bytes[i]);
    }
  }
}

void Drive::reply(uint64_t now) {
  int32_t number = 0;
  const bool ok = !strcmp(line_, "ok");
  const bool value = !strncmp(line_, "v ", 2) && parse(line_ + 2, number);
  const bool error = !strncmp(line_, "e ", 2) && parse(line_ + 2, number);
  const bool optional = phase_ == Phase::Running && turn_ == kSlowTurn;
  const Waiting waiting = waiting_;
  waiting_ = Waiting::Nothing;
  if (waiting == Waiting::Ok && ok) {
    take_ok();
  } else if (waiting == Waiting::Ok && error) {
    take_error();
  } else if (waiting == Waiting::Value && value) {
    take_value(number, now);
  } else if (waiting == Waiting::Value && error && optional) {  // not every drive has it
    round_[turn_++] = 0;
  } else {
    fail(now);
  }
}

// What cannot be read is as if nothing had come: more may be wrong than this line.
void Drive::fail(uint64_t now) {
  waiting_ = Waiting::Nothing;
  quiet_until_ = now + kResyncTime;
  turn_ = 0;
  acceleration_ = deceleration_ = 0;
  if (phase_ == Phase::Running) return;
  baud_ = baud_ == kBaud ? kFirstBaud : kBaud;
  phase_ = Phase::Begin;
}

// --- the connection -----------------------------------------------------------------------------

// After power-up the drive listens at 9600 baud; if only this board was reset, at 115200. Each is
// tried in turn. (To a drive at 115200, bytes at 9600 are a break, which resets its rate.)
void Drive::connect(uint64_t now) {
  switch (phase_) {
    case Phase::Begin:
      measured_ = Measurement{};
      turn_ = 0;
      mode_ = Mode::Off;
      refused_ = true;  // the command must be repeated
      begin(Demand{});
      referenced_ = paused_ = false;
      acceleration_ = deceleration_ = 0;
      board_.set_baud(baud_);
      send("\r", 1, now);
      quiet_until_ = now + kClearTime;
      phase_ = Phase::Probe;
      break;
    case Phase::Probe:
      get(kStatus, now);
      break;
    case Phase::Rate:
      send("s r0x90 115200\r", 15, now);
      quiet_until_ = now + kRateTime;
      phase_ = Phase::Switch;
      break;
    case Phase::Switch:
      board_.set_baud(baud_ = kBaud);
      quiet_until_ = now + kSwitchTime;
      phase_ = Phase::Probe;
      break;
    case Phase::Running:
      break;
  }
}

// --- readings -----------------------------------------------------------------------------------

void Drive::read_next(uint64_t now) {
  const uint8_t slow = kSlowReadings[slow_turn_ % sizeof kSlowReadings];
  get(turn_ == kSlowTurn ? slow : kRound[turn_], now);
}

void Drive::take_value(int32_t value, uint64_t now) {
  if (phase_ == Phase::Probe) {
    phase_ = baud_ == kBaud ? Phase::Running : Phase::Rate;
    alive_ = now;
    return;
  }
  round_[turn_++] = value;
  if (turn_ < sizeof kRound) return;
  if (value != static_cast<int32_t>(kBaud)) return fail(now);
  turn_ = 0;
  end_round(now);
}

void Drive::end_round(uint64_t now) {
  const auto status = static_cast<uint32_t>(round_[3]);
  const bool reset = measured_.clock != 0 && (status & ~measured_.status & kReset);
  measured_.clock = position_clock_;
  measured_.position = round_[0];
  measured_.velocity = round_[1];
  measured_.current = round_[2];
  measured_.status = status;
  const bool referenced = (round_[4] & (kReferencedBit | kHomingBit)) == kReferencedBit;
  homings_ = static_cast<uint16_t>(homings_ + (referenced && !referenced_));
  referenced_ = referenced;
  take_mode(round_[5]);
  if (reset) phase_ = Phase::Begin;  // connect again: no motion resumes by itself
  switch (kSlowReadings[slow_turn_++ % sizeof kSlowReadings]) {
    case kFaults: faults_ = static_cast<uint32_t>(round_[kSlowTurn]); break;
    case kSupply: supply_ = round_[kSlowTurn]; break;
    case kTemperature: temperature_ = round_[kSlowTurn]; break;
    default: abort_ = round_[kSlowTurn];
  }
  alive_ = now;
  paused_ = false;
}

// The drive may be in another mode than was acknowledged, as acknowledgements get lost. One that
// was switched off externally is connected again, so that no motion resumes by itself; an unknown
// mode is braked like current mode.
void Drive::take_mode(int32_t value) {
  const bool known = value == 0 || value == 11 || value == 21;
  const Mode mode = known ? static_cast<Mode>(value) : Mode::Current;
  if (mode == mode_) return;
  if (mode == Mode::Off) phase_ = Phase::Begin;
  mode_ = mode;
  begin(demand_);
}

// --- orders -------------------------------------------------------------------------------------

bool Drive::order_next(uint64_t now) {
  if (paused_ || measured_.clock == 0) return false;
  if (clearing_ && mode_ == Mode::Off) {  // one that is on would move on by itself
    order({kFaults, static_cast<int32_t>(faults_)}, now);
    return true;
  }
  const Demand::Goal goal = demand_.goal;
  const bool other_mode = mode_ != mode_of(goal);
  if (goal == Demand::Hold || goal == Demand::Release || (goal != Demand::Off && other_mode)) {
    if (!braked_) {
      if (follow(brake(), now)) return true;
      braked_ = true;
      braked_at_ = mode_ == Mode::Off ? 0 : now;
      step_ = 0;
    }
    const bool too_long = goal == Demand::Release && now - braked_at_ > kPatience;
    if (!at_rest() && !too_long) return false;
  }
  done_ = !follow(program(), now);
  return !done_;
}

// Gives the next order of a plan; false: there are no more.
bool Drive::follow(const Plan& plan, uint64_t now) {
  for (; step_ < plan.size; ++step_) {
    const Write& write = plan.writes[step_];
    if (is_so(write)) continue;
    order(write, now);
    return true;
  }
  return false;
}

// Whether the drive has acknowledged this, and nothing else since.
bool Drive::is_so(const Write& write) const {
  switch (write.variable) {
    case kDesiredState: return write.value == static_cast<int32_t>(mode_);
    case kAccelerationLimit: return write.value == acceleration_;
    case kDecelerationLimit: return write.value == deceleration_;
    default: return false;
  }
}

// In every mode with the drive's own abort deceleration.
Drive::Plan Drive::brake() const {
  Plan plan;
  if (mode_ == Mode::Position) {
    plan.add(kTrajectory, kAbort);
  } else if (mode_ != Mode::Off) {
    if (abort_) plan.add(kDecelerationLimit, to_limit(abort_));
    plan.add(kCommandedVelocity, 0);
    plan.add(kDesiredState, static_cast<int32_t>(Mode::Velocity));
  }
  return plan;
}

// The mode comes last where a set-point left over from before would be followed.
Drive::Plan Drive::program() const {
  Plan plan;
  const int32_t acceleration = demand_.acceleration;
  const auto mode = static_cast<int32_t>(mode_of(demand_.goal));
  switch (demand_.goal) {
    case Demand::Current:
      plan.add(kCommandedCurrent, demand_.set_point);
      plan.add(kDesiredState, mode);
      break;
    case Demand::Velocity:
      if (acceleration) {
        plan.add(kAccelerationLimit, to_limit(acceleration));
        plan.add(kDecelerationLimit, to_limit(acceleration));
      }
      plan.add(kCommandedVelocity, demand_.set_point);
      plan.add(kDesiredState, mode);
      break;
    case Demand::Home:
      plan.add(kDesiredState, mode);
      plan.add(kTrajectory, kFindHome);
      break;
    case Demand::Position:
      plan.add(kDesiredState, mode);
      plan.add(kProfileType, 0);
      plan.add(kTarget, demand_.set_point);
      plan.add(kProfileVelocity, demand_.velocity);
      if (acceleration) {
        plan.add(kProfileAcceleration, acceleration);
        plan.add(kProfileDeceleration, acceleration);
      }
      plan.add(kTrajectory, kStart);
      break;
    default:
      plan.add(kDesiredState, mode);
  }
  return plan;
}

void Drive::take_ok() {
  if (write_.variable == kFaults) {
    clearing_ = false;
    faults_ = 0;
    return;
  }
  if (write_.variable == kDesiredState) mode_ = static_cast<Mode>(write_.value);
  if (write_.variable == kAccelerationLimit) acceleration_ = write_.value;
  if (write_.variable == kDecelerationLimit) deceleration_ = write_.value;
  if (write_.variable == kTrajectory && write_.value == kFindHome) referenced_ = false;
  if (!outdated_) ++step_;
}

// After a refused demand the joint is held; if it cannot be held, the drive is switched off.
void Drive::take_error() {
  paused_ = true;
  if (write_.variable == kFaults) {
    clearing_ = false;
    return;
  }
  if (outdated_) return;
  Demand instead;
  instead.goal = demand_.goal > Demand::Hold ? Demand::Hold : Demand::Off;
  refused_ = true;
  begin(instead);
}

// --- lines --------------------------------------------------------------------------------------

void Drive::get(uint8_t variable, uint64_t now) {
  Line line;
  line.add("g");
  line.add_variable(variable);
  line.add("\r");
  variable_ = variable;
  waiting_ = Waiting::Value;
  send(line.text, line.size, now);
}

void Drive::order(Write write, uint64_t now) {
  Line line;
  line.add(write.variable == kTrajectory ? "t" : "s");
  if (write.variable != kTrajectory) line.add_variable(write.variable);
  line.add(write.value);
  line.add("\r");
  write_ = write;
  ordered_at_ = now;
  outdated_ = false;
  if (write.variable == kAccelerationLimit) acceleration_ = 0;
  if (write.variable == kDecelerationLimit) deceleration_ = 0;
  const bool homes = write.variable == kTrajectory && write.value == kFindHome;
  if (homes || write.variable == kDesiredState) turn_ = 0;  // the last readings are out of date
  variable_ = 0;
  waiting_ = Waiting::Ok;
  send(line.text, line.size, now);
}

// A line that the board cannot take fails as if it were not answered.
void Drive::send(const char* text, size_t size, uint64_t now) {
  line_size_ = 0;
  asked_at_ = now;
  board_.write(reinterpret_cast<const uint8_t*>(text), size);
}

}  // namespace fss
