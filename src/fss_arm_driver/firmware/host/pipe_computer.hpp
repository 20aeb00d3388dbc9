// A computer whose frames a test puts in and takes out.
#pragma once

#include <algorithm>
#include <deque>
#include <string>
#include <utility>

#include "computer.hpp"
#include "text.hpp"

namespace fss {

class PipeComputer : public Computer {
 public:
  size_t receive(uint8_t* data, size_t room) override {
    if (inbox.empty() && flood > 0) {
      --flood;
      data[0] = 0;
      return 1;
    }
    if (inbox.empty()) return 0;
    const Bytes datagram = inbox.front();
    inbox.pop_front();
    const size_t size = std::min(room, datagram.size());
    std::copy_n(datagram.begin(), size, data);
    return size;
  }
  void answer() override {}
  void send(const uint8_t* frame) override {
    sent_ += (sent_.empty() ? "" : " ") + to_hex(frame, kFrameSize);
  }

  // The frames sent since the last call, in hexadecimal.
  std::string take_sent() {
    const std::string sent = std::exchange(sent_, "");
    return sent.empty() ? "-" : sent;
  }

  std::deque<Bytes> inbox;
  uint32_t flood = 0;  // datagrams of one byte, after those of the inbox

 private:
  std::string sent_;
};

}  // namespace fss
