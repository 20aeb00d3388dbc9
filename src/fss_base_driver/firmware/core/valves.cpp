#include "valves.hpp"

namespace fss {
namespace {

constexpr int64_t kPercent = 100;

template <typename Number>
Number least(Number a, Number b) {
  return a < b ? a : b;
}

}  // namespace

Valves::Valves(const Limits& limits) : limits_(limits), left_(limits.total) {
  for (int64_t& allowance : allowance_) allowance = kPercent * limits.allowance;
}

// From one change to the next one: mostly there is none, and that is found without a division.
void Valves::tick(uint64_t now) {
  while (clock_ < now) {
    pass(changes_by(now) ? least(now, next()) : now);
    settle();
  }
}

void Valves::obey(const BaseCommand& command) {
  expiry_ = command.expiry;
  silent_from_ = clock_ + 1000u * uint64_t{command.watchdog};
  if (command.flags & kStop) {
    stopped_ = true;
    disarm();
  } else if (!(command.flags & kArm)) {
    stopped_ = watchdog_ = limited_ = spent_ = false;
    left_ = limits_.total;
    disarm();
  } else if (!stopped_ && !watchdog_ && !spent_) {
    armed_ = true;
    if (command.pulse == 0) close();
    else if (command.pulse != pulse_) begin(command);
  }
}

uint8_t Valves::flags() const {
  return static_cast<uint8_t>((armed_ ? kArmed : 0) | (stopped_ ? kStopped : 0) |
                              (watchdog_ ? kWatchdog : 0) | (limited_ ? kLimited : 0) |
                              (spent_ ? kSpent : 0));
}

uint16_t Valves::pulse_age() const {
  const uint64_t age = (clock_ - begun_) / kTimeUnit;
  return static_cast<uint16_t>(pulse_ && age < UINT16_MAX ? age : UINT16_MAX);
}

void Valves::begin(const BaseCommand& command) {
  pulse_ = command.pulse;
  begun_ = clock_;
  for (int i = 0; i < kValves; ++i) {
    const uint32_t time = kTimeUnit * command.on_times[i];
    if (time > limits_.longest) limited_ = true;
    until_[i] = clock_ + least(time, limits_.longest);
  }
  settle();
}

// Whether anything may change by itself up to then.
bool Valves::changes_by(uint64_t time) const {
  if (!armed_) return false;
  if (time > silent_from_) return true;
  if (open_ == 0) return false;
  const uint64_t passed = time - clock_;
  if (time > expiry_ || passed * count_ >= left_) return true;
  const int64_t drained = static_cast<int64_t>(passed) * (kPercent - limits_.duty);
  for (int i = 0; i < kValves; ++i) {
    if (open_ >> i & 1 && (time >= until_[i] || drained >= allowance_[i])) return true;
  }
  return false;
}

// Earliest time of a change without a command; later than now. Only for an armed board.
uint64_t Valves::next() const {
  uint64_t last = silent_from_;  // before the change
  if (open_) {
    const int64_t drain = limits_.duty < kPercent ? kPercent - limits_.duty : 1;
    for (int i = 0; i < kValves; ++i) {
      if (!(open_ >> i & 1)) continue;
      last = least(last, until_[i] - 1);
      last = least(last, clock_ + static_cast<uint64_t>((allowance_[i] - 1) / drain));
    }
    last = least(last, least(expiry_, clock_ + (left_ - 1) / count_));
  }
  return (last > clock_ ? last : clock_) + 1;
}

// Lets time pass in which nothing changes.
void Valves::pass(uint64_t time) {
  const uint64_t passed = time - clock_;
  const int64_t full = kPercent * limits_.allowance;
  for (int i = 0; i < kValves; ++i) {
    const bool open = open_ >> i & 1;
    if (open) opened_[i] += passed;
    const int64_t gain = limits_.duty - (open ? kPercent : 0);
    allowance_[i] = least(allowance_[i] + static_cast<int64_t>(passed) * gain, full);
  }
  const uint64_t used = passed * count_;
  left_ = used < left_ ? left_ - static_cast<uint32_t>(used) : 0;
  clock_ = time;
}

// Closes the valves that must not be open any longer.
void Valves::settle() {
  if (armed_ && clock_ > silent_from_) {
    watchdog_ = true;
    disarm();
  } else if (armed_ && left_ == 0) {
    spent_ = true;
    disarm();
  } else if (armed_ && clock_ > expiry_) {
    close();
  }
  open_ = count_ = 0;
  for (int i = 0; i < kValves; ++i) {
    if (until_[i] <= clock_) continue;
    if (allowance_[i] <= 0) {
      until_[i] = 0;
      limited_ = true;
      continue;
    }
    open_ = static_cast<uint8_t>(open_ | 1 << i);
    ++count_;
  }
}

void Valves::disarm() {
  armed_ = false;
  close();
}

void Valves::close() {
  for (uint64_t& until : until_) until = 0;
  open_ = count_ = 0;
}

}  // namespace fss
