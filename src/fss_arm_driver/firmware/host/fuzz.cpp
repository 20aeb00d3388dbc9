// Random and damaged inputs to a link in simulated time, under sanitizers: `fuzz COUNT [SEED]`.
//
// An input is a datagram, a piece of a byte stream, or noise on the drive's line. Datagrams are
// noise, commands, segments of paths, old ones again, and damaged ones, half of which have CRC and
// signature put right. Checked after each: what is taken is byte for byte a frame that was sealed,
// what is refused changes nothing, a link that is long disarmed does not move, none that is not
// armed holds a path, one that follows a path is told no more than its most velocity, and the heap
// does not grow.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <optional>

#include "bench_board.hpp"
#include "blake2s.hpp"
#include "bytes.hpp"
#include "fuzzing.hpp"
#include "link.hpp"

extern "C" size_t __sanitizer_get_current_allocated_bytes();

namespace fss {
namespace {

constexpr uint64_t kPatience = 5'000'000;  // for a disarmed link to come to rest [us]
constexpr uint64_t kOutdated = 50'000;     // no set-point goes on for longer [us],
constexpr uint64_t kLost = 600'000;        // or than this, after noise on the drive's line
constexpr size_t kGrowth = 20'000;         // of what the simulated drive keeps at times [bytes]

class Fuzzer : Chance {
 public:
  Fuzzer(uint32_t seed, const Key& key) : Chance(seed), key_(key) { restart(); }

  void run(unsigned long long count) {
    printf("%s: %llu inputs\n", key_.size ? "signed" : "not signed",
           count);
    for (uint64_t i = 0; i < count; ++i) {
      if (i == count / 5) heap_ = __sanitizer_get_current_allocated_bytes();
      if (any(5000) == 0) restart();
      if (any(3000) == 0) calm_ = !calm_;
      pass();
      input();
    }
    restart();
    printf("  taken %llu commands and %llu segments, refused %llu, telemetry %llu, starts %u\n"
           "  paths followed for %.0f s, broken %llu times, turns of the joint %.0f\n",
           taken_, kept_, refused_, computer_.sent[1], boot_ - 1,
           1e-6 * static_cast<double>(followed_), broken_, way_ / 240'000);
    const size_t heap = __sanitizer_get_current_allocated_bytes();
    check(heap < heap_ + kGrowth, "the heap grows");
    check(computer_.sent[1] > count / 4000 && computer_.sent[0] == 0, "telemetry does not flow");
    check(taken_ > count / 50, "hardly anything was taken");
    check(kept_ > count / 200, "hardly a segment was taken");
    // In a short run, chance may give no path that fits.
    check(count < 100'000 || (broken_ >= count / 100'000 && followed_ > count),
          "hardly a path was followed");
    check(refused_ > count / 3, "hardly anything was refused");
  }

 private:
  void check(bool holds, const char* what) {
    if (holds) return;
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
  }

  // Lets time pass, 1 ms on average.
  void pass() {
    const uint64_t end = now_ + any(2000);
    for (; now_ < end; now_ += 500) {
      const uint8_t before = link_->flags();
      poll();
      check_path(before);
    }
    const double velocity = fabs(board_.drive().velocity());
    way_ += velocity * 0.001;
    if (link_->flags() & kArmed) disarmed_ = now_;
    check(now_ - disarmed_ < kPatience || velocity < 1.0, "a disarmed link moves");
  }

  void check_path(uint8_t before) {
    const uint8_t flags = link_->flags();
    check(flags & kArmed || link_->paths().holds_none(), "a path outlives its link's being armed");
    check(flags & kArmed || !(flags & (kFollowing | kBroken)), "who is not armed follows");
    broken_ += (flags & ~before & kBroken) != 0;
    if (!(flags & kFollowing)) followed_since_ = now_;
    followed_ += flags & kFollowing ? 500 : 0;
    const uint64_t since = std::max(followed_since_, most_since_);
    if (now_ - since > kOutdated && now_ - noise_at_ > kLost) {
      const int32_t told = board_.drive().set_velocity();
      check(told <= most_ && told >= -most_, "a path is followed too fast");
    }
  }

  // The link's electronics, not the drive: a new clock, nothing remembered.
  void restart() {
    if (link_) taken_ += link_->gate().taken(), refused_ += link_->gate().refused();
    link_.emplace(uint8_t{2}, ++boot_, key_, board_, computer_);
  }

  // Until all that has come is read, so that nothing but an input can change anything then.
  void poll() {
    board_.pass(now_);
    do link_->poll(now_);
    while (board_.drive().has_come(now_));
  }

  void input() {
    Data frame;
    const uint32_t kind = any(100);
    const bool part = any(2);
    if (kind < 10) {
      uint8_t bytes[kFrameSize + 20];
      noise(bytes, sizeof bytes);
      deliver(bytes, any(sizeof bytes), false);
    } else if (kind < 25) {
      part ? segment(frame) : command(frame);
      deliver(frame, kFrameSize, true);
    } else if (kind < 35) {
      deliver(old_[any(kOld)], kFrameSize, true);
    } else if (kind < 80) {
      part ? segment(frame) : command(frame);
      const bool sealed = any(2);
      const bool damaged = damage(frame, sealed ? 52 : kFrameSize);
      if (sealed) seal(frame, key_);
      deliver(frame, kFrameSize, sealed || !damaged);
    } else if (kind < 98) {
      stream([this](uint8_t* one) { any(2) ? segment(one) : command(one); },
             [this](const uint8_t* found) { deliver(found, kFrameSize, true); });
    } else if (any(20) == 0) {
      drive_noise();
    }
  }

  // Mostly one that the link may take.
  void command(uint8_t* frame) {
    constexpr uint8_t flags[] = {0, 1, 1, 1, 1, 1, 1, 5, 2, 8, 17};
    constexpr uint8_t modes[] = {0, 1, 11, 21, 21, 31, 31, 31};
    begin(frame, Kind::Command);
    const bool follow = calm_ && any(500);
    const uint8_t arm = link_->flags() & kArmed || any(2) ? kArm : 0;
    frame[5] = follow ? arm : flags[any(sizeof flags)];
    store(frame + 20, now_ + any(2'000'000));
    frame[28] = follow ? 31 : modes[any(sizeof modes)];
    store(frame + 30, static_cast<uint16_t>(200 + any(1000)));
    store(frame + 32, frame[28] == 31 ? path_ : static_cast<int32_t>(any(200'000)) - 100'000);
    store(frame + 36, follow ? fastest_ : static_cast<int32_t>(any(1'000'000)));
    store(frame + 40, static_cast<int32_t>(any(20'000)));
    finish(frame);
  }

  // Of a path that begins where the joint is, soon, or of one before.
  void segment(uint8_t* frame) {
    const bool broken = link_->flags() & kBroken;
    uint64_t passed = now_ > begin_ ? (now_ - begin_) / duration_ : 0;
    if (any(broken || passed >= segments_ ? 50 : 1500) == 0) {
      new_path();
      passed = 0;
    }
    const uint64_t soon = std::min<uint64_t>(passed + any(any(3) ? 4 : 33), segments_ - 1);
    const uint32_t index = any(20) ? static_cast<uint32_t>(soon) : any(segments_);
    begin(frame, Kind::Segment);
    frame[5] = index + 1 == segments_;
    store(frame + 20, static_cast<uint16_t>(path_));
    store(frame + 22, static_cast<uint16_t>(index));
    store(frame + 24, begin_ + index * uint64_t{duration_});
    store(frame + 32, duration_);
    for (uint32_t i = 0; i < 2; ++i) {
      const bool at_end = index + i == 0 || index + i == segments_;
      const int64_t position = from_ + step_ * static_cast<int64_t>(index + i);
      store(frame + 36 + 8 * i, static_cast<int32_t>(position));
      store(frame + 40 + 8 * i, at_end ? 0 : velocity_);
    }
    finish(frame);
  }

  void new_path() {
    constexpr uint32_t counts[] = {1, 5, 30, 1000};
    path_ = (path_ + (any(3) ? 1 : static_cast<int32_t>(any(40'000)))) & 0xFFFF;
    path_ += path_ == 0;
    segments_ = counts[any(4)];
    duration_ = any(2) ? 1000 + any(500'000) : 20'000;
    begin_ = now_ + any(500'000);
    fastest_ = static_cast<int32_t>(any(700'000));
    from_ = static_cast<int64_t>(board_.drive().position()) + any(2'000);
    velocity_ = static_cast<int32_t>(any(600'000)) - 300'000;
    step_ = int64_t{velocity_} * duration_ / 10'000'000;
  }

  // What all frames begin with.
  void begin(uint8_t* frame, Kind kind) {
    memset(frame, 0, kFrameSize);
    store(frame, uint16_t{0x4653});
    frame[2] = 2;
    frame[3] = static_cast<uint8_t>(kind);
    frame[4] = any(20) ? 2 : 3;
    store(frame + 6, static_cast<uint16_t>(any(20) ? boot_ : boot_ - 1));
    store(frame + 8, ++sequence_);
    store(frame + 12, now_ + (any(100) ? 0 : any(200'000)));
  }

  void finish(uint8_t* frame) {
    seal(frame, key_);
    memcpy(old_[any(kOld)], frame, kFrameSize);
  }

  void deliver(const uint8_t* data, size_t size, bool sealed) {
    poll();
    const uint8_t flags = link_->flags();
    const uint32_t taken = link_->gate().taken(), refused = link_->gate().refused();
    computer_.put(data, size);
    poll();
    if (size == 0 || link_->gate().refused() > refused) {
      check(link_->gate().taken() == taken, "it was refused and taken");
      check(link_->flags() == flags, "what was refused changed something");
      check(size == 0 || link_->gate().refused() == refused + 1, "a refusal is not counted");
      return;
    }
    check(sealed, "what was not sealed was taken");
    if (link_->gate().taken() == taken) {
      check(data[3] == 3, "what is no segment was kept");
      check(flags & kArmed, "who is not armed keeps a path");
      check(link_->flags() == flags, "a segment changed more than a path");
      ++kept_;
      return;
    }
    Data same;
    const Command& command = link_->command();
    memset(same, 0, kFrameSize);
    store(same, uint16_t{0x4653});
    same[2] = 2;
    same[3] = 2;
    same[4] = command.link;
    same[5] = command.flags;
    store(same + 6, command.boot);
    store(same + 8, command.sequence);
    store(same + 12, command.clock);
    store(same + 20, command.expiry);
    same[28] = static_cast<uint8_t>(command.mode);
    store(same + 30, command.watchdog);
    store(same + 32, command.set_point);
    store(same + 36, command.velocity);
    store(same + 40, command.acceleration);
    seal(same, key_);
    check(size == kFrameSize && !memcmp(same, data, kFrameSize), "it was not what was sent");
    if (command.mode == Mode::Path && command.velocity != most_) {
      most_since_ = command.velocity < most_ ? now_ : most_since_;
      most_ = command.velocity;
    }
    const bool arms = command.flags & kArm, stops = command.flags & kStop;
    check(arms || !(link_->flags() & kArmed), "armed by a command that does not arm");
    check(!stops || link_->flags() & kStopped, "a stop that does not stop");
  }

  void drive_noise() {
    static const char* const lines[] = {"ok\r", "e 31\r", "v -2147483648\r", "v 4294967295\r",
                                        "v 99999999999999999999\r", "v\r", "e\r", "\r"};
    uint8_t bytes[40];
    noise(bytes, sizeof bytes);
    const char* line = lines[any(8)];
    noise_at_ = now_;
    if (any(2)) memcpy(bytes, line, strlen(line));
    board_.drive().noise({bytes, bytes + (any(2) ? strlen(line) : any(sizeof bytes))}, now_);
  }

  static constexpr uint32_t kOld = 16;

  const Key key_;
  BenchBoard board_;
  FuzzComputer computer_{Kind::Telemetry};
  std::optional<Link> link_;
  uint16_t boot_ = 0;
  unsigned long long taken_ = 0, refused_ = 0;  // before the last start
  unsigned long long kept_ = 0, broken_ = 0;    // segments and paths
  Data old_[kOld] = {};
  uint32_t sequence_ = 0;
  uint64_t now_ = 0, disarmed_ = 0;
  // The path that is sent.
  bool calm_ = true;  // that it be followed for a while
  int32_t path_ = 1, velocity_ = 0, fastest_ = 0;
  uint32_t segments_ = 1, duration_ = 1000;
  uint64_t begin_ = 0;
  int64_t from_ = 0, step_ = 0;
  // Of the one that the link follows.
  int32_t most_ = 0;
  uint64_t most_since_ = 0, followed_since_ = 0, noise_at_ = 0, followed_ = 0;
  size_t heap_ = 0;
  double way_ = 0.0;
};

}  // namespace
}  // namespace fss

// Freed memory is not kept for long, so that what the process holds is what it uses.
extern "C" const char* __asan_default_options() { return "quarantine_size_mb=1"; }

int main(int argc, char** argv) {
  return fss::fuzz_all(argc, argv, "fuzz", [](auto seed, const auto& key, auto count) {
    fss::Fuzzer(seed, key).run(count);
  });
}
