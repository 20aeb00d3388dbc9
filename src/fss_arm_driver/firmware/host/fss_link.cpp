// The firmware as a process on this computer, a simulated drive behind it:
//
//   fss_link --link 1 --udp 5001 [--keys FILE]     datagrams, on this host's port (0: any)
//   fss_link --link 1 --tcp 5001 [--keys FILE]     a byte stream, on this host's port
//   fss_link --link 1 --pty [--keys FILE]          a serial line, at a pseudo-terminal
//
// `--serial NUMBER`: that the link tells; 0, the default: it has none.
//
// Prints one line that says where it is, and runs until it is killed.

#include "bench_board.hpp"
#include "link.hpp"
#include "process.hpp"

int main(int argc, char** argv) {
  const fss::Options options = fss::read_options(argc, argv, "fss_link", true);
  fss::BenchBoard board;
  fss::Link link(options.link, fss::any_start(), options.key, board, *options.connection,
                 options.serial);
  fss::serve("link " + std::to_string(options.link), options, board, link);
}
