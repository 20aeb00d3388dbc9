// Random and damaged inputs to the base's board in simulated time, under sanitizers:
// `base_fuzz COUNT [SEED]`.
//
// An input is a datagram or a piece of a byte stream: noise, commands, old ones again, and damaged
// ones, half of which have CRC and signature put right. At times the loop hangs and only the timer
// runs. Checked after each step: what is taken is byte for byte a frame that was sealed, what is
// refused changes nothing; a valve is never open unarmed, beyond its on time, after expiry or
// silence, for longer than the longest pulse, its allowance and duty, or the total time; none is
// open that no pulse opened; telemetry tells what was measured; the heap does not grow.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <optional>

#include "base.hpp"
#include "bench_base.hpp"
#include "bytes.hpp"
#include "fuzzing.hpp"

extern "C" size_t __sanitizer_get_current_allocated_bytes();

namespace fss {
namespace {

constexpr uint64_t kStep = 100;   // of the timer [us]
constexpr size_t kGrowth = 1000;  // [bytes]
constexpr Limits kTight = {200'000, 150'000, 30, 400'000};

class Fuzzer : Chance {
 public:
  Fuzzer(uint32_t seed, const Key& key, const Limits& limits)
      : Chance(seed), key_(key), limits_(limits) {
    restart();
  }

  void run(unsigned long long count) {
    printf("%s, longest pulse %u ms: %llu inputs\n", key_.size ? "signed" : "not signed",
           limits_.longest / 1000, count);
    for (uint64_t i = 0; i < count; ++i) {
      if (i == count / 5) heap_ = __sanitizer_get_current_allocated_bytes();
      if (any(20'000) == 0) restart();
      if (any(300) == 0) hangs_ = any(3) == 0;
      if (any(2000) == 0) calm_ = !calm_;
      pass(any(500) ? any(1000) : any(700'000));
      if (hangs_) hangs_ = any(100) != 0;
      else input();
    }
    restart();
    printf("  taken %llu, refused %llu, telemetry %llu, starts %u, pulses %llu\n"
           "  valve seconds %.0f, longest open %.1f ms\n"
           "  trips: watchdog %llu, limited %llu, spent %llu, expired %llu\n",
           taken_, refused_, computer_.sent[1], boot_ - 1, pulses_, 1e-6 * flown_,
           1e-3 * static_cast<double>(longest_), trips_[0], trips_[1], trips_[2], expired_);
    check(__sanitizer_get_current_allocated_bytes() < heap_ + kGrowth, "the heap grows");
    check(computer_.sent[1] > count / 400 && computer_.sent[0] == 0, "telemetry does not flow");
    check(taken_ > count / 20 && refused_ > count / 5, "hardly anything was taken or refused");
    check(pulses_ > count / 100 && flown_ > static_cast<double>(count), "hardly a valve was open");
    check(trips_[0] >= count / 20'000, "the watchdog hardly tripped");
    check(expired_ >= count / 20'000, "hardly a pulse expired");
    check(trips_[1] >= count / 20'000, "hardly a limit was reached");
    check(trips_[2] >= count / 100'000 || limits_.total > kTight.total, "time is never spent");
  }

 private:
  void check(bool holds, const char* what) {
    if (holds) return;
    fprintf(stderr, "base_fuzz: %s at %llu us\n", what, static_cast<unsigned long long>(now_));
    abort();
  }

  void pass(uint64_t time) {
    for (const uint64_t end = now_ + time; now_ < end;) {
      const uint64_t step = std::min<uint64_t>(end - now_, any(4) ? kStep : 1 + any(kStep));
      const uint8_t before = board_.driven;
      now_ += step;
      for (int i = 0; i < kValves; ++i) {  // as they were, until now
        if (!(before >> i & 1)) continue;
        used_ += step;
        flown_ += static_cast<double>(step);
        longest_ = std::max(longest_, now_ - begun_);
      }
      board_.pass(now_);
      hangs_ ? base_->tick(now_) : base_->poll(now_);
      count_trips();
      expired_ += before && !board_.driven && now_ - step <= expiry_ && now_ > expiry_;
      check_valves(before, step);
    }
  }

  void count_trips() {
    const uint8_t risen = static_cast<uint8_t>(base_->valves().flags() & ~flags_);
    trips_[0] += (risen & kWatchdog) != 0;
    trips_[1] += (risen & kLimited) != 0;
    trips_[2] += (risen & kSpent) != 0;
    flags_ = base_->valves().flags();
  }

  // By what the computer sent, not by what the firmware thinks.
  void check_valves(uint8_t before, uint64_t step) {
    const uint8_t open = board_.driven;
    check(!open || base_->valves().flags() & kArmed, "open, not armed");
    check(!(open & ~before), "opened by itself");
    check(!open || !(base_->valves().flags() & (kStopped | kWatchdog | kSpent)), "open, latched");
    check(!open || now_ <= silent_, "open in silence");
    check(!open || now_ <= expiry_, "open after expiry");
    for (int i = 0; i < kValves; ++i) {
      const bool was = before >> i & 1, is = open >> i & 1;
      most_[i] += static_cast<int64_t>(step) * (limits_.duty - (is ? 100 : 0));
      most_[i] = std::min(most_[i], int64_t{100} * limits_.allowance);
      // One that closed did so within the step, and may have been told to at its beginning.
      if (was && !is) used_ -= step;
      check(!is || now_ < ends_[i], "open beyond its on time");
      check(!is || now_ < begun_ + limits_.longest, "open beyond the longest pulse");
      check(!is || most_[i] >= 0, "open beyond its duty");
    }
    check(!open || used_ < limits_.total, "open beyond the total time");
  }

  // The electronics alone: a new clock, nothing remembered.
  void restart() {
    if (base_) taken_ += base_->gate().taken(), refused_ += base_->gate().refused();
    base_.emplace(++boot_, key_, board_, computer_, limits_);
    board_.open(0);
    now_ = used_ = silent_ = expiry_ = begun_ = 0;
    board_.restart();
    pulse_ = 0;
    for (int64_t& most : most_) most = int64_t{100} * limits_.allowance;
    for (uint64_t& end : ends_) end = 0;
    hangs_ = false;
    check_encoding();
  }

  void input() {
    Data frame;
    const uint32_t kind = any(100);
    if (kind < 5) {
      uint8_t bytes[kFrameSize + 20];
      noise(bytes, sizeof bytes);
      deliver(bytes, any(sizeof bytes), false);
    } else if (kind < 40) {
      command(frame);
      deliver(frame, kFrameSize, true);
    } else if (kind < 50) {
      deliver(old_[any(kOld)], kFrameSize, true);
    } else if (kind < 80) {
      command(frame);
      const bool sealed = any(2);
      const bool damaged = damage(frame, sealed ? 52 : kFrameSize);
      if (sealed) seal(frame, key_);
      deliver(frame, kFrameSize, sealed || !damaged);
    } else {
      stream([this](uint8_t* one) { command(one); },
             [this](const uint8_t* found) { deliver(found, kFrameSize, true); });
    }
  }

  // Mostly one that the board may take.
  void command(uint8_t* frame) {
    constexpr uint8_t flags[] = {0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 2};
    const uint8_t known = base_->valves().flags();
    const bool latched = known & (kStopped | kWatchdog | kSpent);
    BaseCommand command = {};
    command.link = any(100) ? 0 : 1;
    command.flags = latched && any(4) == 0 ? 0 : any(30) ? kArm : flags[any(sizeof flags)];
    if (!(known & kArmed) && any(4) == 0) command.flags = 0;
    command.boot = static_cast<uint16_t>(any(30) ? boot_ : boot_ - 1);
    command.sequence = ++sequence_;
    // With a key, a stamp from far ahead has all that follows refused.
    command.clock = stamp_ += 1 + any(100);
    command.watchdog = static_cast<uint16_t>(any(3) ? 500 : 20 + any(300));
    command.expiry = now_ + any(any(calm_ ? 100 : 3) ? 1'000'000 : 60'000);
    if (command.flags & kArm) {
      command.pulse = static_cast<uint16_t>(base_->valves().pulse() + (any(calm_ ? 300 : 3) == 0));
      if (any(500) == 0) command.pulse = static_cast<uint16_t>(random_());
      const uint32_t most = any(2) ? 100 : any(3) ? 3000 : 65536;
      for (uint16_t& time : command.on_times) {
        time = static_cast<uint16_t>(command.pulse && any(3) == 0 ? any(most) : 0);
      }
      command.grip = static_cast<Grip>(any(3));
    }
    write(command, frame);
    memcpy(old_[any(kOld)], frame, kFrameSize);
  }

  // As the protocol's page says, by code that is not the core's.
  void write(const BaseCommand& command, uint8_t* frame) {
    memset(frame, 0, kFrameSize);
    store(frame, uint16_t{0x4653});
    frame[2] = 2;
    frame[3] = 5;
    frame[4] = command.link;
    frame[5] = command.flags;
    store(frame + 6, command.boot);
    store(frame + 8, command.sequence);
    store(frame + 12, command.clock);
    store(frame + 20, command.expiry);
    store(frame + 28, command.pulse);
    store(frame + 30, command.watchdog);
    for (int i = 0; i < kValves; ++i) store(frame + 32 + 2 * i, command.on_times[i]);
    frame[48] = static_cast<uint8_t>(command.grip);
    seal(frame, key_);
  }

  // Of random telemetry: every field is where the page says.
  void check_encoding() {
    BaseTelemetry frame;
    Data data, same = {};
    frame.link = 0;
    frame.flags = static_cast<uint8_t>(any(32));
    frame.boot = static_cast<uint16_t>(random_());
    frame.sequence = static_cast<uint32_t>(random_());
    frame.clock = uint64_t{random_()} << 32 | random_();
    store(same + 20, frame.echo = static_cast<uint32_t>(random_()));
    store(same + 24, frame.turnaround = static_cast<uint32_t>(random_()));
    store(same + 28, frame.gyro_sum = static_cast<uint32_t>(random_()));
    store(same + 32, frame.gyro_samples = static_cast<uint16_t>(random_()));
    same[34] = frame.valves = static_cast<uint8_t>(random_());
    same[35] = frame.gripper = static_cast<uint8_t>(any(8));
    store(same + 36, frame.pulse = static_cast<uint16_t>(random_()));
    store(same + 38, frame.pulse_age = static_cast<uint16_t>(random_()));
    same[40] = static_cast<uint8_t>(1 + any(16));
    frame.slow_id = static_cast<BaseSlow>(same[40]);
    store(same + 44, frame.slow_value = static_cast<int32_t>(random_()));
    encode(frame, key_, data);
    store(same, uint16_t{0x4653});
    same[2] = 2;
    same[3] = 4;
    same[5] = frame.flags;
    store(same + 6, frame.boot);
    store(same + 8, frame.sequence);
    store(same + 12, frame.clock);
    seal(same, key_);
    check(!memcmp(same, data, kFrameSize), "telemetry is not encoded as it should be");
  }

  void deliver(const uint8_t* data, size_t size, bool sealed) {
    base_->poll(now_);
    const uint8_t flags = base_->valves().flags(), before = board_.driven;
    const uint32_t taken = base_->gate().taken(), refused = base_->gate().refused();
    computer_.put(data, size);
    base_->poll(now_);
    if (size == 0 || base_->gate().refused() > refused) {
      check(base_->gate().taken() == taken, "it was refused and taken");
      check(base_->valves().flags() == flags && board_.driven == before,
            "what was refused changed something");
      check(size == 0 || base_->gate().refused() == refused + 1, "a refusal is not counted");
      return;
    }
    check(sealed, "what was not sealed was taken");
    check(base_->gate().taken() == taken + 1, "it was neither taken nor refused");
    Data same;
    const BaseCommand& command = base_->command();
    write(command, same);
    check(size == kFrameSize && !memcmp(same, data, kFrameSize), "it was not what was sent");
    check_order(command, flags, before);
  }

  // What a command that was taken did.
  void check_order(const BaseCommand& command, uint8_t flags, uint8_t before) {
    const uint8_t after = base_->valves().flags();
    const bool arms = command.flags & kArm, stops = command.flags & kStop;
    check(arms || !(after & kArmed), "armed by a command that does not arm");
    check(!stops || after & kStopped, "a stop that does not stop");
    check(arms || !board_.driven, "open after a stop or a disarm");
    check(!(flags & (kStopped | kWatchdog | kSpent)) || !(after & kArmed), "armed though latched");
    check(command.pulse || !board_.driven, "open without a pulse");
    silent_ = now_ + 1000 * uint64_t{command.watchdog};
    expiry_ = command.expiry;
    count_trips();
    if (!arms && !stops) used_ = 0;
    if (!(after & kArmed) || command.pulse == 0 || command.pulse == pulse_) {
      check(!(board_.driven & ~before), "opened without a new pulse");
      return;
    }
    ++pulses_;
    pulse_ = command.pulse;
    begun_ = now_;
    for (int i = 0; i < kValves; ++i) {
      ends_[i] = now_ + 100 * uint64_t{command.on_times[i]};
      const bool open = board_.driven >> i & 1;
      check(open ? command.on_times[i] != 0 : command.on_times[i] == 0 || after & kLimited,
            "a pulse opens other valves than it should");
    }
  }

  static constexpr uint32_t kOld = 16;

  const Key key_;
  const Limits limits_;
  BenchBase board_;
  FuzzComputer computer_{Kind::BaseTelemetry};
  std::optional<Base> base_;
  uint16_t boot_ = 0;
  unsigned long long taken_ = 0, refused_ = 0;  // before the last start
  unsigned long long pulses_ = 0, trips_[3] = {}, expired_ = 0;
  Data old_[kOld] = {};
  uint32_t sequence_ = 0;
  uint64_t stamp_ = 0, now_ = 0;
  bool hangs_ = false, calm_ = false;
  uint8_t flags_ = 0;
  // What the computer knows of the last command, and of the pulse that it began.
  uint64_t silent_ = 0, expiry_ = 0, begun_ = 0, ends_[kValves] = {};
  uint16_t pulse_ = 0;
  // How long valves were open, and may be still.
  uint64_t used_ = 0, longest_ = 0;
  int64_t most_[kValves] = {};  // [us / 100]
  double flown_ = 0.0;
  size_t heap_ = 0;
};

}  // namespace
}  // namespace fss

// Freed memory is not kept for long, so that what the process holds is what it uses.
extern "C" const char* __asan_default_options() { return "quarantine_size_mb=1"; }

int main(int argc, char** argv) {
  return fss::fuzz_all(argc, argv, "base_fuzz", [](auto seed, const auto& key, auto count) {
    for (const fss::Limits& limits : {fss::kLimits, fss::kTight}) {
      fss::Fuzzer(seed, key, limits).run(count / 2);
    }
  });
}
