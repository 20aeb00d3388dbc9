// A board's firmware as a process on this computer: its options, its time, and its connection to
// what drives it. Whatever is wrong with these ends the process with a message.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <memory>
#include <string>

#include "blake2s.hpp"
#include "computer.hpp"

namespace fss {

class Connection : public Computer {
 public:
  virtual ~Connection() = default;
  std::string where;
};

struct Options {
  uint8_t link;
  int32_t serial;  // of the physical link; 0: none
  Key key;
  std::unique_ptr<Connection> connection;
};

// Of a program of this name. Links are numbered; the base's board is 0.
Options read_options(int argc, char** argv, const char* program, bool numbered);

uint16_t any_start();     // a random number that is never 0
uint64_t microseconds();  // since some time
void pause_a_little();

// Prints where the board is, and runs its firmware until the process is killed.
template <typename Firmware, typename Board>
[[noreturn]] void serve(const std::string& name, const Options& options, Board& board,
                        Firmware& firmware) {
  printf("%s at %s, %s\n", name.c_str(), options.connection->where.c_str(),
         options.key.size ? "signed" : "not signed");
  fflush(stdout);
  for (const uint64_t start = microseconds();; pause_a_little()) {
    const uint64_t now = microseconds() - start;
    board.pass(now);
    firmware.poll(now);
  }
}

}  // namespace fss
