#include "drive_model.hpp"

#include <math.h>
#include <stdio.h>

#include <algorithm>
#include <iterator>
#include <utility>

namespace fss {
namespace {

constexpr uint64_t kStep = 1000;           // of the motion [us]
constexpr uint64_t kHoming = 300'000;      // a homing takes [us]
constexpr double kDt = 1e-6 * kStep;
constexpr double kFastest = 800'000.0;     // 200 turns a minute [counts/s]
constexpr double kFriction = 200'000.0;    // deceleration of the free joint [counts/s^2]
constexpr double kPull = 400'000.0;        // acceleration by a current [counts/s^2/A]
constexpr size_t kOrders = 10'000;         // kept, at most [characters]
constexpr uint32_t kLatched = 1u << 22, kDisabled = 1u << 12, kReset = 1u << 20, kMoving = 1u << 27;
constexpr int kUnknown = 9, kReadOnly = 11, kNotEnabled = 31, kParse = 33;

std::string error(int code) { return "e " + std::to_string(code); }
std::string value(double number) { return "v " + std::to_string(lround(number)); }

// Variables that may be read and written, and what they are after power-up.
constexpr struct {
  uint8_t id;
  int32_t value;
} kDefaults[] = {{0x02, 0},     {0x24, 0},      {0x2f, 0}, {0x36, 1000}, {0x37, 1000}, {0x6a, 0},
                 {0x90, 9600},  {0xa4, 0},      {0xb8, 0}, {0xb9, 0},    {0xc8, 0},    {0xca, 0},
                 {0xcb, 0},     {0xcc, 10'000}, {0xcd, 10'000},          {0xcf, 30'000}};

bool is_variable(uint8_t id) {
  return std::any_of(std::begin(kDefaults), std::end(kDefaults),
                     [id](const auto& known) { return known.id == id; });
}

}  // namespace

void DriveModel::reset() {
  for (const auto& known : kDefaults) registers_[known.id] = known.value;
}

// --- the line -----------------------------------------------------------------------------------

void DriveModel::set_baud(uint32_t baud, uint64_t now) {
  advance(now);
  computer_baud_ = baud;
}

void DriveModel::write(const uint8_t* data, size_t size, uint64_t now) {
  advance(now);
  for (size_t i = 0; i < size; ++i) {
    sent_ = std::max(sent_, now) + 10'000'000 / computer_baud_;
    if (plugged_) to_drive_.push_back({sent_, computer_baud_, data[i]});
  }
}

size_t DriveModel::read(uint8_t* data, size_t room, uint64_t now) {
  advance(now);
  size_t size = 0;
  while (size < room && has_come(now)) {
    const Byte byte = to_computer_.front();
    to_computer_.pop_front();
    if (plugged_) data[size++] = byte.baud == computer_baud_ ? byte.value : byte.value ^ 0x5A;
  }
  return size;
}

bool DriveModel::has_come(uint64_t now) const {
  return !to_computer_.empty() && to_computer_.front().at <= now;
}

void DriveModel::noise(const std::vector<uint8_t>& bytes, uint64_t now) {
  for (const uint8_t byte : bytes) to_computer_.push_back({now, computer_baud_, byte});
}

void DriveModel::power_cycle() {
  reset();
  line_.clear();
  to_drive_.clear();
  to_computer_.clear();
  baud_ = 9600;
  was_reset_ = true;
  moving_ = aborting_ = referenced_ = false;
}

void DriveModel::latch_faults(uint32_t bits) {
  registers_[0xa4] |= static_cast<int32_t>(bits);
  moving_ = false;
}

std::string DriveModel::take_orders() {
  const std::string orders = std::exchange(orders_, "");
  return orders.empty() ? "-" : orders;
}

// Lets its time pass: the motion, and the bytes that come meanwhile.
void DriveModel::advance(uint64_t now) {
  while (!to_drive_.empty() && to_drive_.front().at <= now) {
    const Byte byte = to_drive_.front();
    to_drive_.pop_front();
    for (; now_ + kStep <= byte.at; now_ += kStep) step();
    hear(byte);
  }
  for (; now_ + kStep <= now; now_ += kStep) step();
}

void DriveModel::hear(const Byte& byte) {
  if (byte.baud < baud_) {  // so long a low level is a break
    registers_[0x90] = 9600;
    baud_ = 9600;
    line_.clear();
  } else if (byte.baud > baud_) {
    line_ += '?';
  } else if (byte.value == '\r') {
    execute(line_, byte.at);
    line_.clear();
  } else if (line_.size() < 100) {
    line_ += static_cast<char>(byte.value);
  }
}

void DriveModel::execute(const std::string& line, uint64_t now) {
  if (line.compare(0, 2, "g ") != 0 && orders_.size() < kOrders) {
    orders_ += (orders_.empty() ? "" : "; ") + line;
  }
  const std::string reply = answer(line) + "\r";
  answered_ = std::max(answered_, now + latency_);
  for (const char character : reply) {
    answered_ += 10'000'000 / baud_;
    to_computer_.push_back({answered_, baud_, static_cast<uint8_t>(character)});
  }
}

// --- the protocol -------------------------------------------------------------------------------

std::string DriveModel::answer(const std::string& line) {
  unsigned id = 0;
  long long number = 0;
  int end = -1;
  const auto whole = [&](int found, int expected) {
    return found == expected && end == static_cast<int>(line.size()) && id <= 0xFF;
  };
  if (whole(sscanf(line.c_str(), "g r0x%x%n", &id, &end), 1)) return get(static_cast<uint8_t>(id));
  const bool command = whole(sscanf(line.c_str(), "t %lld%n", &number, &end), 1);
  if (!command && !whole(sscanf(line.c_str(), "s r0x%x %lld%n", &id, &number, &end), 2)) {
    return error(kParse);
  }
  if (error_) return error(std::exchange(error_, 0));
  const auto value = static_cast<int32_t>(static_cast<uint32_t>(number));
  return command ? trajectory(value) : set(static_cast<uint8_t>(id), value);
}

std::string DriveModel::get(uint8_t variable) {
  if (lacks_ && variable == lacks_) return error(kUnknown);
  switch (variable) {
    case 0x32: return value(position_);
    case 0x18: return value(10.0 * velocity_ + (shakes_ ? 5000.0 : 0.0));
    case 0x0c: return value(current_);
    case 0x1e: return value(240);
    case 0x20: return value(31);
    case 0xc9: return value((referenced_ ? 1 << 12 : 0) | (now_ < homed_ ? 1 << 13 : 0) | (aborting_ ? 1 << 14 : 0) |
                            (moving_ ? 1 << 15 : 0));
    case 0xa0: return value(status());
    default: break;
  }
  return is_variable(variable) ? value(registers_[variable]) : error(kUnknown);
}

std::string DriveModel::set(uint8_t variable, int32_t number) {
  int32_t& now = registers_[variable];
  if (!is_variable(variable)) return error(get(variable)[0] == 'v' ? kReadOnly : kUnknown);
  if (variable == 0xa4) {
    now &= ~number;
    return "ok";
  }
  if (variable == 0x24 && now != number) moving_ = aborting_ = false;
  if (variable == 0x90) baud_ = static_cast<uint32_t>(number);
  now = number;
  return "ok";
}

std::string DriveModel::trajectory(int32_t command) {
  if (mode() != 21 || registers_[0xa4]) return error(kNotEnabled);
  if (command == 0) {
    aborting_ = moving_;
  } else if (command == 1) {
    target_ = registers_[0xca];
    moving_ = true;
    aborting_ = false;
  } else if (command == 2) {  // set up to take the present place for the reference
    homed_ = now_ + kHoming;
    referenced_ = true;
  }
  return "ok";
}

uint32_t DriveModel::status() const {
  const bool faulty = registers_[0xa4] != 0;
  return (faulty ? kLatched : 0) | (mode() == 0 || faulty ? kDisabled : 0) |
         (was_reset_ ? kReset : 0) | reported_ | (fabs(velocity_) >= 1.0 ? kMoving : 0);
}

// --- the motion ---------------------------------------------------------------------------------

void DriveModel::step() {
  current_ = 0.0;
  if (mode() == 0 || registers_[0xa4]) {
    approach(0.0, kFriction);
  } else if (mode() == 1) {
    current_ = registers_[0x02];
    velocity_ += 0.01 * current_ * kPull * kDt;
    approach(0.0, 0.1 * kFriction);
  } else if (mode() == 11) {
    const double wanted = 0.1 * registers_[0x2f];
    approach(wanted, 1000.0 * registers_[fabs(wanted) < fabs(velocity_) ? 0x37 : 0x36]);
  } else {
    follow_profile();
  }
  velocity_ = std::clamp(velocity_, -kFastest, kFastest);
  position_ += velocity_ * kDt;
}

void DriveModel::follow_profile() {
  if (!moving_ || aborting_) {
    approach(0.0, 10.0 * registers_[0xcf]);
    moving_ = moving_ && velocity_ != 0.0;
    return;
  }
  const double deceleration = 10.0 * registers_[0xcd], way = target_ - position_;
  const double fastest = std::min(0.1 * registers_[0xcb], sqrt(2.0 * deceleration * fabs(way)));
  if (fabs(way) <= fabs(velocity_) * kDt || fabs(way) < 1.0) {
    position_ = target_;
    velocity_ = 0.0;
    moving_ = false;
    return;
  }
  approach(copysign(fastest, way),
           fastest < fabs(velocity_) ? 2.0 * deceleration : 10.0 * registers_[0xcc]);
}

void DriveModel::approach(double velocity, double acceleration) {
  const double most = acceleration * kDt;
  velocity_ += std::clamp(velocity - velocity_, -most, most);
}

}  // namespace fss
