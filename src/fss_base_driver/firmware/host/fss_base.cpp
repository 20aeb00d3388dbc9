// The firmware as a process on this computer, the model of the base's hardware behind it:
//
//   fss_base --udp 5000 [--keys FILE]     datagrams, on this host's port (0: any)
//   fss_base --tcp 5000 [--keys FILE]     a byte stream, on this host's port
//   fss_base --pty [--keys FILE]          a serial line, at a pseudo-terminal
//
// Prints one line that says where it is, and runs until it is killed.

#include "base.hpp"
#include "bench_base.hpp"
#include "process.hpp"

int main(int argc, char** argv) {
  const fss::Options options = fss::read_options(argc, argv, "fss_base", false);
  fss::BenchBase board;
  fss::Base base(fss::any_start(), options.key, board, *options.connection);
  fss::serve("base", options, board, base);
}
