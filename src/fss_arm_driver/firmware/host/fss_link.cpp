// The firmware as a process on this computer, a simulated drive behind it:
//
//   fss_link --link 1 --udp 5001 [--keys FILE]     datagrams, on this host's port (0: any)
//   fss_link --link 1 --pty [--keys FILE]          a serial line, at a pseudo-terminal
//
// Prints one line that says where it is, and runs until it is killed.

#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <string>

#include "bench_board.hpp"
#include "link.hpp"
#include "stream.hpp"
#include "text.hpp"

namespace fss {
namespace {

constexpr long kPause = 300'000;  // between two polls [ns]

[[noreturn]] void fail(const std::string& what) {
  fprintf(stderr, "fss_link: %s\n", what.c_str());
  exit(1);
}

uint64_t microseconds() {
  timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<uint64_t>(time.tv_sec) * 1'000'000 + static_cast<uint64_t>(time.tv_nsec) / 1000;
}

class UdpBoard : public BenchBoard {
 public:
  explicit UdpBoard(uint16_t port) : socket_(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0)) {
    sockaddr_in address = {};
    socklen_t size = sizeof address;
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    if (bind(socket_, reinterpret_cast<sockaddr*>(&address), size) != 0) {
      fail("UDP port " + std::to_string(port) + " cannot be opened: " + strerror(errno));
    }
    getsockname(socket_, reinterpret_cast<sockaddr*>(&address), &size);
    where = "udp " + std::to_string(ntohs(address.sin_port));
  }

  size_t receive(uint8_t* data, size_t room) override {
    socklen_t size = sizeof sender_;
    const ssize_t got =
        recvfrom(socket_, data, room, 0, reinterpret_cast<sockaddr*>(&sender_), &size);
    return got > 0 ? static_cast<size_t>(got) : 0;
  }
  void answer() override { peer_ = sender_; }
  void send(const uint8_t* frame) override {
    if (peer_.sin_port == 0) return;
    sendto(socket_, frame, kFrameSize, 0, reinterpret_cast<sockaddr*>(&peer_), sizeof peer_);
  }

  std::string where;

 private:
  const int socket_;
  sockaddr_in sender_ = {}, peer_ = {};
};

class PtyBoard : public BenchBoard {
 public:
  PtyBoard() : line_(posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK)) {
    if (line_ < 0 || grantpt(line_) != 0 || unlockpt(line_) != 0) {
      fail(std::string("no pseudo-terminal: ") + strerror(errno));
    }
    where = std::string("serial ") + ptsname(line_);
    const int end = open(ptsname(line_), O_RDWR | O_NOCTTY);  // kept open, so that none hangs up
    termios settings;
    tcgetattr(end, &settings);
    cfmakeraw(&settings);
    tcsetattr(end, TCSANOW, &settings);
  }

  size_t receive(uint8_t* data, size_t room) override {
    uint8_t byte;
    while (::read(line_, &byte, 1) == 1) {
      if (const uint8_t* frame = reader_.take(byte)) {
        memcpy(data, frame, std::min(room, kFrameSize));
        return kFrameSize;
      }
    }
    return 0;
  }
  void answer() override {}
  void send(const uint8_t* frame) override {
    uint8_t bytes[kStreamedSize];
    to_stream(frame, bytes);
    if (::write(line_, bytes, sizeof bytes) < 0) return;  // nobody reads: lost, as on a wire
  }

  std::string where;

 private:
  const int line_;
  StreamReader reader_;
};

// The key of a link, from a file with a line for each: its number and the key in hexadecimal.
Key load_key(const char* path, unsigned link) {
  FILE* file = fopen(path, "r");
  struct stat status;
  if (!file || fstat(fileno(file), &status) != 0) fail(std::string(path) + " cannot be read");
  if (status.st_mode & 077) fail(std::string(path) + " is open to others, expected mode 600");
  char line[256], digits[65];
  unsigned number = 0;
  while (fgets(line, sizeof line, file)) {
    if (sscanf(line, "%u %64[0-9a-fA-F]", &number, digits) != 2 || number != link) continue;
    fclose(file);
    return key_of(from_hex(digits));
  }
  fail(std::string(path) + " has no key of link " + std::to_string(link));
}

template <typename Board>
[[noreturn]] void run(Board& board, uint8_t number, const Key& key) {
  uint16_t boot = 0;
  while (boot == 0 && getrandom(&boot, sizeof boot, 0) >= 0) {}
  Link link(number, boot, key, board);
  printf("link %u at %s, %s\n", number, board.where.c_str(), key.size ? "signed" : "not signed");
  fflush(stdout);
  for (const uint64_t start = microseconds();;) {
    const uint64_t now = microseconds() - start;
    board.pass(now);
    link.poll(now);
    const timespec pause = {0, kPause};
    nanosleep(&pause, nullptr);
  }
}

int whole(const char* name, const char* text, int low, int high) {
  char* end = nullptr;
  const long number = strtol(text, &end, 10);
  if (*end || end == text || number < low || number > high) {
    fail(std::string(name) + " is '" + text + "', expected " + std::to_string(low) + " to " +
         std::to_string(high));
  }
  return static_cast<int>(number);
}

}  // namespace
}  // namespace fss

int main(int argc, char** argv) {
  const option options[] = {{"link", required_argument, nullptr, 'l'},
                            {"udp", required_argument, nullptr, 'u'},
                            {"pty", no_argument, nullptr, 'p'},
                            {"keys", required_argument, nullptr, 'k'},
                            {nullptr, 0, nullptr, 0}};
  int number = 0, port = -1;
  bool pty = false;
  const char* keys = nullptr;
  for (int which; (which = getopt_long(argc, argv, "", options, nullptr)) != -1;) {
    switch (which) {
      case 'l': number = fss::whole("link", optarg, 1, 255); break;
      case 'u': port = fss::whole("udp", optarg, 0, 65535); break;
      case 'p': pty = true; break;
      case 'k': keys = optarg; break;
      default: number = 0;
    }
  }
  if (number == 0 || (port < 0) == !pty || optind < argc) {
    fprintf(stderr, "usage: fss_link --link NUMBER (--udp PORT | --pty) [--keys FILE]\n");
    return 1;
  }
  const auto link = static_cast<uint8_t>(number);
  const fss::Key key = keys ? fss::load_key(keys, link) : fss::Key{};
  if (pty) {
    fss::PtyBoard board;
    fss::run(board, link, key);
  }
  fss::UdpBoard board(static_cast<uint16_t>(port));
  fss::run(board, link, key);
}
