// What all boards on an Arduino Due have alike: how they reach the computer, count the time and
// number their starts.
#pragma once

#include <Arduino.h>
#include <SPI.h>
#include <WiFi.h>
#include <WiFiUdp.h>

#include "computer.hpp"
#include "frame.hpp"
#include "stream.hpp"

namespace fss {

// A random number that is never 0: the Due has no memory to count its starts in.
inline uint16_t start_number() {
  uint16_t number = 0;
  pmc_enable_periph_clk(ID_TRNG);
  trng_enable(TRNG);
  while (number == 0) number = static_cast<uint16_t>(trng_read_output_data(TRNG));
  return number;
}

// Keeps interrupts out for as long as it lives; within another it does nothing more.
class NoInterrupts {
 public:
  NoInterrupts() : were_off_(__get_PRIMASK() != 0) { noInterrupts(); }
  ~NoInterrupts() {
    if (!were_off_) interrupts();
  }
  NoInterrupts(const NoInterrupts&) = delete;
  NoInterrupts& operator=(const NoInterrupts&) = delete;

 private:
  const bool were_off_;
};

class DueClock {
 public:
  // The time since the start [us]. To be called at least once an hour, as micros() wraps.
  uint64_t now() {
    const NoInterrupts alone;
    now_ += static_cast<uint32_t>(micros() - static_cast<uint32_t>(now_));
    return now_;
  }

 private:
  uint64_t now_ = 0;
};

// By datagrams.
class WifiComputer : public Computer {
 public:
  // Takes seconds, in which nothing else happens.
  bool connect(const char* network, const char* password, uint16_t port) {
    char name[33] = {};  // the library wants one that may be written
    strncpy(name, network, sizeof name - 1);
    connected_ = WiFi.begin(name, password) == WL_CONNECTED && udp_.begin(port) == 1;
    return connected_;
  }
  bool online() { return WiFi.status() == WL_CONNECTED; }

  size_t receive(uint8_t* data, size_t room) override {
    if (!connected_ || udp_.parsePacket() <= 0) return 0;
    const int size = udp_.read(data, room);
    udp_.flush();  // what did not fit
    return size > 0 ? static_cast<size_t>(size) : 0;
  }
  void answer() override {
    peer_ = udp_.remoteIP();
    peer_port_ = udp_.remotePort();
  }
  void send(const uint8_t* frame) override {
    if (!connected_ || peer_port_ == 0 || !udp_.beginPacket(peer_, peer_port_)) return;
    udp_.write(frame, kFrameSize);
    udp_.endPacket();
  }

 private:
  WiFiUDP udp_;
  IPAddress peer_;
  uint16_t peer_port_ = 0;
  bool connected_ = false;
};

// At the end of a wire: TX2 is pin 16, RX2 is pin 17.
class WireComputer : public Computer {
 public:
  bool connect(const char*, const char*, uint16_t) {
    Serial2.begin(115200);
    return true;
  }
  bool online() { return true; }

  size_t receive(uint8_t* data, size_t) override {
    while (Serial2.available() > 0) {
      const uint8_t* frame = reader_.take(static_cast<uint8_t>(Serial2.read()));
      if (!frame) continue;
      memcpy(data, frame, kFrameSize);
      return kFrameSize;
    }
    return 0;
  }
  void answer() override {}
  void send(const uint8_t* frame) override {
    uint8_t bytes[kStreamedSize];
    to_stream(frame, bytes);
    if (Serial2.availableForWrite() < static_cast<int>(sizeof bytes)) return;
    Serial2.write(bytes, sizeof bytes);
  }

 private:
  StreamReader reader_;
};

}  // namespace fss
