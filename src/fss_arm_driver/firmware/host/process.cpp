#include "process.hpp"

#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <vector>

#include "stream.hpp"
#include "text.hpp"

namespace fss {
namespace {

constexpr long kPause = 300'000;  // between two polls [ns]

std::string program;

[[noreturn]] void fail(const std::string& what) {
  fprintf(stderr, "%s: %s\n", program.c_str(), what.c_str());
  exit(1);
}

// A socket of this host's port (0: any), and where it is.
int bound(int type, uint16_t port, const char* name, std::string& where) {
  const int made = socket(AF_INET, type | SOCK_NONBLOCK, 0);
  const int yes = 1;
  if (type == SOCK_STREAM) setsockopt(made, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  sockaddr_in address = {};
  socklen_t size = sizeof address;
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  if (bind(made, reinterpret_cast<sockaddr*>(&address), size) != 0) {
    fail(std::string(name) + " port " + std::to_string(port) +
         " cannot be opened: " + strerror(errno));
  }
  getsockname(made, reinterpret_cast<sockaddr*>(&address), &size);
  for (const char* at = name; *at; ++at) where += static_cast<char>(*at | 0x20);
  where += " " + std::to_string(ntohs(address.sin_port));
  return made;
}

class Udp : public Connection {
 public:
  explicit Udp(uint16_t port) : socket_(bound(SOCK_DGRAM, port, "UDP", where)) {}

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

 private:
  const int socket_;
  sockaddr_in sender_ = {}, peer_ = {};
};

// A frame as a stream carries it.
struct Streamed {
  explicit Streamed(const uint8_t* frame) { to_stream(frame, bytes); }
  uint8_t bytes[kStreamedSize];
};

// Finds the frames in what `read` gives, which returns how much that is, 0 or less: nothing.
class Frames {
 public:
  // The size of the next frame, cut to `room`; 0: none yet. Reads at most once.
  template <typename Read>
  size_t next(uint8_t* data, size_t room, Read read) {
    if (at_ == size_) {
      const ssize_t got = read(bytes_, sizeof bytes_);
      at_ = 0;
      size_ = got > 0 ? static_cast<size_t>(got) : 0;
    }
    while (at_ < size_) {
      if (const uint8_t* frame = reader_.take(bytes_[at_++])) {
        found = true;
        memcpy(data, frame, std::min(room, kFrameSize));
        return kFrameSize;
      }
    }
    return 0;
  }
  bool found = false;  // a frame, ever

 private:
  StreamReader reader_;
  uint8_t bytes_[512];
  size_t at_ = 0, size_ = 0;
};

class Pty : public Connection {
 public:
  Pty() : line_(posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK)) {
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
    return frames_.next(data, room, [this](void* to, size_t size) { return read(line_, to, size); });
  }
  void answer() override {}
  void send(const uint8_t* frame) override {
    const Streamed out(frame);
    if (write(line_, out.bytes, sizeof out.bytes) < 0) return;  // nobody reads: lost, as on a wire
  }

 private:
  const int line_;
  Frames frames_;
};

// Several computers may be connected; telemetry goes to whose command was taken last, as with
// datagrams, so that one that connects and sends nothing, or nonsense, takes it from nobody. While
// that one is gone it goes to who came last.
class Tcp : public Connection {
 public:
  explicit Tcp(uint16_t port) : listener_(bound(SOCK_STREAM, port, "TCP", where)) {
    if (listen(listener_, kMost) != 0) fail(std::string("TCP cannot listen: ") + strerror(errno));
  }

  size_t receive(uint8_t* data, size_t room) override {
    accept_next();
    const size_t begin = turn_++;
    for (size_t i = 0; i < lines_.size(); ++i) {
      const size_t k = (begin + i) % lines_.size();
      bool gone = false;
      const int socket = lines_[k]->socket;
      const size_t size = lines_[k]->frames.next(data, room, [&](void* to, size_t most) {
        const ssize_t got = recv(socket, to, most, 0);
        gone = got == 0 || (got < 0 && errno != EAGAIN);
        return got;
      });
      if (gone) {
        hang_up(k);
        return 0;
      }
      if (size > 0) {
        sender_ = socket;
        return size;
      }
    }
    return 0;
  }
  void answer() override { peer_ = sender_; }
  // What the computer does not read in time is lost; a frame cut short, with the next one's zero.
  void send(const uint8_t* frame) override {
    if (lines_.empty()) return;
    size_t to = lines_.size() - 1;
    for (size_t k = 0; k < lines_.size(); ++k) {
      if (lines_[k]->socket == peer_) to = k;
    }
    const Streamed out(frame);
    const int socket = lines_[to]->socket;
    if (::send(socket, out.bytes, sizeof out.bytes, MSG_NOSIGNAL) < 0 && errno != EAGAIN) {
      hang_up(to);
    }
  }

 private:
  static constexpr size_t kMost = 4;
  struct Line {
    int socket;
    Frames frames;
  };

  // Takes in one that connects. It has the place of one that never sent a frame, or else of the
  // oldest, but never of the one that telemetry goes to.
  void accept_next() {
    const int next = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK);
    if (next < 0) return;
    const int yes = 1;
    setsockopt(next, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    if (lines_.size() == kMost) {
      size_t out = kMost;
      for (size_t k = kMost; k-- > 0;) {
        if (lines_[k]->socket == peer_) continue;
        if (out == kMost || !lines_[k]->frames.found || lines_[out]->frames.found) out = k;
      }
      hang_up(out);
    }
    lines_.push_back(std::make_unique<Line>());
    lines_.back()->socket = next;
  }
  void hang_up(size_t k) {
    if (lines_[k]->socket == peer_) peer_ = -1;
    close(lines_[k]->socket);
    lines_.erase(lines_.begin() + static_cast<std::ptrdiff_t>(k));
  }

  const int listener_;
  std::vector<std::unique_ptr<Line>> lines_;  // the oldest first
  int sender_ = -1, peer_ = -1;
  size_t turn_ = 0;  // with whom to begin, so that none keeps the others waiting
};

// The key of a board, from a file with a line for each: its number and the key in hexadecimal.
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

Options read_options(int argc, char** argv, const char* name, bool numbered) {
  program = name;
  const option options[] = {{"udp", required_argument, nullptr, 'u'},
                            {"tcp", required_argument, nullptr, 't'},
                            {"pty", no_argument, nullptr, 'p'},
                            {"keys", required_argument, nullptr, 'k'},
                            {numbered ? "link" : nullptr, required_argument, nullptr, 'l'},
                            {"serial", required_argument, nullptr, 's'},  // of a link only
                            {nullptr, 0, nullptr, 0}};
  int number = 0, serial = 0, udp = -1, tcp = -1;
  bool pty = false, known = true;
  const char* keys = nullptr;
  for (int which; (which = getopt_long(argc, argv, "", options, nullptr)) != -1;) {
    switch (which) {
      case 'l': number = whole("link", optarg, 1, 255); break;
      case 's': serial = whole("serial", optarg, 0, INT32_MAX); break;
      case 'u': udp = whole("udp", optarg, 0, 65535); break;
      case 't': tcp = whole("tcp", optarg, 0, 65535); break;
      case 'p': pty = true; break;
      case 'k': keys = optarg; break;
      default: known = false;
    }
  }
  const bool one_way = (udp >= 0) + (tcp >= 0) + pty == 1;
  if (!known || !one_way || (number == 0) == numbered || optind < argc) {
    fprintf(stderr, "usage: %s%s (--udp PORT | --tcp PORT | --pty) [--keys FILE]\n", name,
            numbered ? " --link NUMBER [--serial NUMBER]" : "");
    exit(1);
  }
  Options read;
  read.link = static_cast<uint8_t>(number);
  read.serial = serial;
  read.key = keys ? load_key(keys, read.link) : Key{};
  if (pty) read.connection = std::make_unique<Pty>();
  else if (udp >= 0) read.connection = std::make_unique<Udp>(static_cast<uint16_t>(udp));
  else read.connection = std::make_unique<Tcp>(static_cast<uint16_t>(tcp));
  return read;
}

uint16_t any_start() {
  uint16_t boot = 0;
  while (boot == 0 && getrandom(&boot, sizeof boot, 0) >= 0) {}
  return boot;
}

uint64_t microseconds() {
  timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<uint64_t>(time.tv_sec) * 1'000'000 + static_cast<uint64_t>(time.tv_nsec) / 1000;
}

void pause_a_little() {
  const timespec pause = {0, kPause};
  nanosleep(&pause, nullptr);
}

}  // namespace fss
