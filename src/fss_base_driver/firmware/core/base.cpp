#include "base.hpp"

namespace fss {
namespace {

constexpr int kBatch = 8;  // datagrams taken at once, so that a flood cannot keep telemetry waiting

class Locked {
 public:
  explicit Locked(BaseBoard& board) : board_(board) { board_.lock(); }
  ~Locked() { board_.unlock(); }
  Locked(const Locked&) = delete;
  Locked& operator=(const Locked&) = delete;

 private:
  BaseBoard& board_;
};

}  // namespace

void Base::tick(uint64_t now) {
  const Locked alone(board_);
  valves_.tick(now);
  const uint8_t open = valves_.open();
  for (int i = 0; i < kValves; ++i) {
    if ((open ^ driven_) >> i & 1) switched_[i] = valves_.clock();
  }
  driven_ = open;
  board_.open(open);
  int32_t counts;
  if (board_.gyro(counts)) {
    gyro_sum_ += static_cast<uint32_t>(counts);
    ++gyro_samples_;
  }
}

void Base::poll(uint64_t now) {
  tick(now);
  uint8_t datagram[kFrameSize + 1];  // a byte more shows that it is too long
  for (int i = 0; i < kBatch; ++i) {
    const size_t size = computer_.receive(datagram, sizeof datagram);
    if (size == 0) break;
    if (!take(datagram, size, now)) gate_.refuse();
  }
  watch_currents();
  if (now < due_) return;
  due_ = (now / kBasePeriod + 1) * kBasePeriod;
  report();
}

// Whether these bytes are a command that is taken.
bool Base::take(const uint8_t* data, size_t size, uint64_t now) {
  BaseCommand command;
  if (decode(data, size, key_, command) != Refusal::None) return false;
  if (!gate_.take(command, now)) return false;
  computer_.answer();
  command_ = command;
  {
    const Locked alone(board_);
    valves_.obey(command);
    tick(now);
  }
  if (command.grip != Grip::Keep && valves_.armed()) {
    grip_ = command.grip;
    board_.grip(grip_);
  }
  return true;
}

// Stores the last state of each valve's current, once the valve was driven, or not driven, for long
// enough: a pulse may have ended before the telemetry is sent.
void Base::watch_currents() {
  const Locked alone(board_);
  const uint8_t currents = board_.currents();
  for (int i = 0; i < kValves; ++i) {
    if (valves_.clock() - switched_[i] < kSettled) continue;
    const bool driven = driven_ >> i & 1, draws = currents >> i & 1;
    const int bit = 1 << (driven ? i : i + kValves);
    faults_ = static_cast<uint16_t>(driven == draws ? faults_ & ~bit : faults_ | bit);
  }
}

void Base::report() {
  const Readings readings = board_.readings();
  BaseTelemetry frame;
  frame.link = kBoard;
  frame.boot = boot_;
  frame.sequence = sequence_;
  frame.echo = gate_.echo();
  frame.gripper = static_cast<uint8_t>((grip_ == Grip::Close ? kToldToClose : 0) |
                                       (board_.gripper() & (kClosed | kHolds)));
  frame.slow_id = static_cast<BaseSlow>(1 + sequence_ % kBaseSlowFields);
  {
    const Locked alone(board_);
    frame.flags = valves_.flags();
    frame.clock = valves_.clock();
    frame.gyro_sum = gyro_sum_;
    frame.gyro_samples = gyro_samples_;
    frame.valves = valves_.open();
    frame.pulse = valves_.pulse();
    frame.pulse_age = valves_.pulse_age();
    frame.slow_value = slow_value(frame.slow_id, readings);
  }
  frame.turnaround = gate_.turnaround(frame.clock);
  ++sequence_;
  uint8_t data[kFrameSize];
  encode(frame, key_, data);
  computer_.send(data);
}

int32_t Base::slow_value(BaseSlow slow, const Readings& readings) const {
  switch (slow) {
    case BaseSlow::Tank: return readings.tank;
    case BaseSlow::Supply: return readings.supply;
    case BaseSlow::Battery: return readings.battery;
    case BaseSlow::Temperature: return readings.temperature;
    case BaseSlow::Firmware: return kBaseFirmware;
    case BaseSlow::Refused: return static_cast<int32_t>(gate_.refused());
    case BaseSlow::Faults: return faults_;
    case BaseSlow::Left: return static_cast<int32_t>(valves_.left() / 1000);
    default: break;
  }
  const int valve = static_cast<int>(slow) - static_cast<int>(BaseSlow::Open1);
  return static_cast<int32_t>(static_cast<uint32_t>(valves_.opened(valve) / 1000));
}

}  // namespace fss
