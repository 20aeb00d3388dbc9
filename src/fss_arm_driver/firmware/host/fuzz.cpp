// Random and damaged inputs to a link in simulated time, under sanitizers: `fuzz COUNT [SEED]`.
//
// An input is a datagram, a piece of a byte stream, or noise on the drive's line. Datagrams are
// noise, commands, old ones again, and damaged ones, half of which have CRC and signature put
// right. Checked after each: what is taken is byte for byte a command that was sealed, what is
// refused changes nothing, a link that is long disarmed does not move, and the heap does not grow.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <optional>
#include <random>

#include "bench_board.hpp"
#include "blake2s.hpp"
#include "bytes.hpp"
#include "link.hpp"
#include "stream.hpp"

extern "C" size_t __sanitizer_get_current_allocated_bytes();

namespace fss {
namespace {

constexpr uint64_t kPatience = 5'000'000;  // for a disarmed link to come to rest [us]
constexpr size_t kGrowth = 20'000;         // of what the simulated drive keeps at times [bytes]

using Frame = uint8_t[kFrameSize];

uint32_t crc32(const uint8_t* data, size_t size) {
  uint32_t crc = 0xFFFFFFFF;
  for (size_t i = 0; i < 8 * size; ++i) {
    const bool odd = (crc ^ static_cast<uint32_t>(data[i / 8] >> i % 8)) & 1;
    crc = crc >> 1 ^ (odd ? 0xEDB88320 : 0);
  }
  return ~crc;
}

void seal(uint8_t* frame, const Key& key) {
  store(frame + 52, crc32(frame, 52));
  memset(frame + 56, 0, 16);
  if (key.size) blake2s(key, frame, 56, frame + 56, 16);
}

class FuzzBoard : public BenchBoard {
 public:
  size_t receive(uint8_t* data, size_t room) override {
    const size_t size = std::min(room, size_);
    memcpy(data, datagram_, size);
    size_ = 0;
    return size;
  }
  void answer() override {}
  void send(const uint8_t* frame) override { ++sent[frame[3] == 1]; }

  void put(const uint8_t* data, size_t size) {
    size_ = std::min(size, sizeof datagram_);
    memcpy(datagram_, data, size_);
  }

  unsigned long long sent[2] = {};  // what is not telemetry, and what is

 private:
  uint8_t datagram_[100] = {};
  size_t size_ = 0;
};

class Fuzzer {
 public:
  Fuzzer(uint32_t seed, const Key& key) : random_(seed), key_(key) { restart(); }

  void run(unsigned long long count) {
    printf("%s: %llu inputs\n", key_.size ? "signed" : "not signed",
           count);
    for (uint64_t i = 0; i < count; ++i) {
      if (i == count / 5) heap_ = __sanitizer_get_current_allocated_bytes();
      if (any(5000) == 0) restart();
      pass();
      input();
    }
    restart();
    printf("  taken %llu, refused %llu, telemetry %llu, starts %u, turns of the joint %.0f\n",
           taken_, refused_, board_.sent[1], boot_ - 1, way_ / 240'000);
    const size_t heap = __sanitizer_get_current_allocated_bytes();
    check(heap < heap_ + kGrowth, "the heap grows");
    check(board_.sent[1] > count / 4000 && board_.sent[0] == 0, "telemetry does not flow");
    check(taken_ > count / 50, "hardly anything was taken");
    check(refused_ > count / 3, "hardly anything was refused");
  }

 private:
  uint32_t any(uint32_t below) { return static_cast<uint32_t>(random_() % below); }

  void check(bool holds, const char* what) {
    if (holds) return;
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
  }

  // Lets time pass, 1 ms on average.
  void pass() {
    const uint64_t end = now_ + any(2000);
    for (; now_ < end; now_ += 500) poll();
    const double velocity = fabs(board_.drive().velocity());
    way_ += velocity * 0.001;
    if (link_->flags() & kArmed) disarmed_ = now_;
    check(now_ - disarmed_ < kPatience || velocity < 1.0, "a disarmed link moves");
  }

  // The link's electronics, not the drive: a new clock, nothing remembered.
  void restart() {
    if (link_) taken_ += link_->gate().taken(), refused_ += link_->gate().refused();
    link_.emplace(uint8_t{2}, ++boot_, key_, board_);
  }

  // Until all that has come is read, so that nothing but an input can change anything then.
  void poll() {
    board_.pass(now_);
    do link_->poll(now_);
    while (board_.drive().has_come(now_));
  }

  void input() {
    Frame frame;
    const uint32_t kind = any(100);
    if (kind < 10) {
      uint8_t bytes[kFrameSize + 20];
      noise(bytes, sizeof bytes);
      deliver(bytes, any(sizeof bytes), false);
    } else if (kind < 25) {
      command(frame);
      deliver(frame, kFrameSize, true);
    } else if (kind < 35) {
      deliver(old_[any(kOld)], kFrameSize, true);
    } else if (kind < 80) {
      command(frame);
      const bool sealed = any(2);
      const bool damaged = damage(frame, sealed ? 52 : kFrameSize);
      if (sealed) seal(frame, key_);
      deliver(frame, kFrameSize, sealed || !damaged);
    } else if (kind < 98) {
      stream();
    } else if (any(20) == 0) {
      drive_noise();
    }
  }

  void noise(uint8_t* data, size_t size) {
    for (size_t i = 0; i < size; ++i) data[i] = static_cast<uint8_t>(random_());
  }

  // Mostly one that the link may take.
  void command(uint8_t* frame) {
    constexpr uint8_t flags[] = {0, 1, 1, 1, 1, 1, 1, 5, 2, 8, 17};
    constexpr uint8_t modes[] = {0, 1, 11, 21, 21, 21};
    memset(frame, 0, kFrameSize);
    store(frame, uint16_t{0x4653});
    frame[2] = 1;
    frame[3] = 2;
    frame[4] = any(20) ? 2 : 3;
    frame[5] = flags[any(sizeof flags)];
    store(frame + 6, static_cast<uint16_t>(any(20) ? boot_ : boot_ - 1));
    store(frame + 8, ++sequence_);
    store(frame + 12, now_ + (any(100) ? 0 : any(200'000)));
    store(frame + 20, now_ + any(2'000'000));
    frame[28] = modes[any(sizeof modes)];
    store(frame + 30, static_cast<uint16_t>(200 + any(1000)));
    store(frame + 32, static_cast<int32_t>(any(200'000)) - 100'000);
    store(frame + 36, static_cast<int32_t>(any(1'000'000)));
    store(frame + 40, static_cast<int32_t>(any(20'000)));
    seal(frame, key_);
    memcpy(old_[any(kOld)], frame, kFrameSize);
  }

  // Whether anything has changed.
  bool damage(uint8_t* frame, size_t size) {
    Frame before;
    memcpy(before, frame, kFrameSize);
    for (uint32_t i = 1 + any(4); i > 0; --i) {
      uint8_t& byte = frame[any(static_cast<uint32_t>(size))];
      constexpr uint8_t extremes[] = {0x00, 0x7F, 0x80, 0xFF};
      byte = any(2) ? extremes[any(4)] : static_cast<uint8_t>(byte ^ 1u << any(8));
    }
    // A sequence number or a stamp from far ahead, once taken, has all that follow it refused.
    if (any(50)) memcpy(frame + 8, before + 8, 12);
    return memcmp(before, frame, kFrameSize) != 0;
  }

  void deliver(const uint8_t* data, size_t size, bool sealed) {
    poll();
    const uint8_t flags = link_->flags();
    const uint32_t taken = link_->gate().taken(), refused = link_->gate().refused();
    board_.put(data, size);
    poll();
    if (link_->gate().taken() == taken) {
      check(link_->flags() == flags, "what was refused changed something");
      check(size == 0 || link_->gate().refused() == refused + 1, "a refusal is not counted");
      return;
    }
    Frame same;
    const Command& command = link_->gate().command();
    memset(same, 0, kFrameSize);
    store(same, uint16_t{0x4653});
    same[2] = 1;
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
    check(sealed, "what was not sealed was taken");
    const bool arms = command.flags & kArm, stops = command.flags & kStop;
    check(arms || !(link_->flags() & kArmed), "armed by a command that does not arm");
    check(!stops || link_->flags() & kStopped, "a stop that does not stop");
  }

  void stream() {
    Frame frame;
    uint8_t bytes[3 * kStreamedSize];
    noise(bytes, sizeof bytes);
    command(frame);
    to_stream(frame, bytes + any(2 * kStreamedSize));
    if (any(2)) bytes[any(sizeof bytes)] = static_cast<uint8_t>(any(3));
    const size_t size = any(4) ? sizeof bytes : any(sizeof bytes);
    for (size_t i = 0; i < size; ++i) {
      if (const uint8_t* found = reader_.take(bytes[i])) deliver(found, kFrameSize, true);
    }
  }

  void drive_noise() {
    static const char* const lines[] = {"ok\r", "e 31\r", "v -2147483648\r", "v 4294967295\r",
                                        "v 99999999999999999999\r", "v\r", "e\r", "\r"};
    uint8_t bytes[40];
    noise(bytes, sizeof bytes);
    const char* line = lines[any(8)];
    if (any(2)) memcpy(bytes, line, strlen(line));
    board_.drive().noise({bytes, bytes + (any(2) ? strlen(line) : any(sizeof bytes))}, now_);
  }

  static constexpr uint32_t kOld = 16;

  std::mt19937 random_;
  const Key key_;
  FuzzBoard board_;
  std::optional<Link> link_;
  uint16_t boot_ = 0;
  unsigned long long taken_ = 0, refused_ = 0;  // before the last start
  StreamReader reader_;
  Frame old_[kOld] = {};
  uint32_t sequence_ = 0;
  uint64_t now_ = 0, disarmed_ = 0;
  size_t heap_ = 0;
  double way_ = 0.0;
};

}  // namespace
}  // namespace fss

// Freed memory is not kept for long, so that what the process holds is what it uses.
extern "C" const char* __asan_default_options() { return "quarantine_size_mb=1"; }

int main(int argc, char** argv) {
  setlinebuf(stdout);  // so that a report comes after what it is about
  const unsigned long long count = argc > 1 ? strtoull(argv[1], nullptr, 10) : 0;
  if (count < 1000) {
    fprintf(stderr, "usage: fuzz COUNT [SEED], COUNT 1000 or more\n");
    return 1;
  }
  const auto seed = static_cast<uint32_t>(argc > 2 ? strtoul(argv[2], nullptr, 10) : 1);
  fss::Key key = {};
  key.size = 16;
  memcpy(key.bytes, "a key of a link.", 16);
  for (const fss::Key& each : {fss::Key{}, key}) {
    fss::Fuzzer fuzzer(seed, each);
    fuzzer.run(count / 2);
  }
  return 0;
}
