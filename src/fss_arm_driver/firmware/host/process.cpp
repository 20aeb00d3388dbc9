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

// A stream of bytes with frames in it.
class Stream : public Connection {
 public:
  size_t receive(uint8_t* data, size_t room) override {
    uint8_t byte;
    while (read_byte(byte)) {
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
    write(bytes, sizeof bytes);
  }

 protected:
  virtual bool read_byte(uint8_t& byte) = 0;
  virtual void write(const uint8_t* bytes, size_t size) = 0;

 private:
  StreamReader reader_;
};

class Pty : public Stream {
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

 private:
  bool read_byte(uint8_t& byte) override { return ::read(line_, &byte, 1) == 1; }
  void write(const uint8_t* bytes, size_t size) override {
    if (::write(line_, bytes, size) < 0) return;  // nobody reads: lost, as on a wire
  }

  const int line_;
};

// One computer at a time: whoever comes later takes the place of the one before, as that one may
// be gone without having said so.
class Tcp : public Stream {
 public:
  explicit Tcp(uint16_t port) : listener_(bound(SOCK_STREAM, port, "TCP", where)) {
    if (listen(listener_, 1) != 0) fail(std::string("TCP cannot listen: ") + strerror(errno));
  }

 private:
  bool read_byte(uint8_t& byte) override {
    const int next = accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK);
    if (next >= 0) {
      hang_up();
      peer_ = next;
      const int yes = 1;
      setsockopt(peer_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    }
    if (peer_ < 0) return false;
    const ssize_t got = recv(peer_, &byte, 1, 0);
    if (got == 0 || (got < 0 && errno != EAGAIN)) hang_up();
    return got == 1;
  }
  // What the computer does not read in time is lost; a frame cut short, with the next one's zero.
  void write(const uint8_t* bytes, size_t size) override {
    if (peer_ >= 0 && ::send(peer_, bytes, size, MSG_NOSIGNAL) < 0 && errno != EAGAIN) hang_up();
  }
  void hang_up() {
    if (peer_ >= 0) close(peer_);
    peer_ = -1;
  }

  const int listener_;
  int peer_ = -1;
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
                            {nullptr, 0, nullptr, 0}};
  int number = 0, udp = -1, tcp = -1;
  bool pty = false, known = true;
  const char* keys = nullptr;
  for (int which; (which = getopt_long(argc, argv, "", options, nullptr)) != -1;) {
    switch (which) {
      case 'l': number = whole("link", optarg, 1, 255); break;
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
            numbered ? " --link NUMBER" : "");
    exit(1);
  }
  Options read;
  read.link = static_cast<uint8_t>(number);
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
