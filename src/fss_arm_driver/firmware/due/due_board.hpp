// The Arduino Due with its shields: RS-232 to the servo drive, the load cell amplifier on two pins,
// and Wi-Fi or a second serial line to the computer.
#pragma once

#include <Arduino.h>
#include <SPI.h>
#include <WiFi.h>
#include <WiFiUdp.h>

#include "board.hpp"
#include "settings.hpp"
#include "stream.hpp"
#include "wiring.hpp"

class DueBoard : public fss::Board {
 public:
  void begin() {
    pinMode(kTorqueDataPin, INPUT_PULLUP);  // without an amplifier there is never a sample
    pinMode(kTorqueClockPin, OUTPUT);
    digitalWrite(kTorqueClockPin, HIGH);  // off and on: it may be in the midst of a reading
    delayMicroseconds(100);
    digitalWrite(kTorqueClockPin, LOW);
    analogReadResolution(12);
  }

  // The time since the start [us]. To be called at least once an hour, as micros() wraps.
  uint64_t now() {
    now_ += static_cast<uint32_t>(micros() - static_cast<uint32_t>(now_));
    return now_;
  }

  void set_baud(uint32_t baud) override { DRIVE_LINE.begin(baud); }
  size_t read(uint8_t* data, size_t room) override {
    size_t size = 0;
    while (size < room && DRIVE_LINE.available() > 0) {
      data[size++] = static_cast<uint8_t>(DRIVE_LINE.read());
    }
    return size;
  }
  bool write(const uint8_t* data, size_t size) override {
    if (DRIVE_LINE.availableForWrite() < static_cast<int>(size)) return false;
    return DRIVE_LINE.write(data, size) == size;
  }

  bool torque_pin() override { return digitalRead(kTorqueDataPin) == HIGH; }
  bool torque_pulse() override {
    noInterrupts();  // high for over 60 us switches the amplifier off
    digitalWrite(kTorqueClockPin, HIGH);
    delayMicroseconds(1);
    const bool bit = torque_pin();
    digitalWrite(kTorqueClockPin, LOW);
    interrupts();
    delayMicroseconds(1);
    return bit;
  }

  uint16_t battery() override {
    return static_cast<uint16_t>(analogRead(kBatteryPin) * kBatteryFullScale / 4095);
  }

 private:
  uint64_t now_ = 0;
};

// The computer by datagrams.
class WifiBoard : public DueBoard {
 public:
  // Takes seconds, in which nothing else happens.
  bool connect() {
    char network[] = WIFI_NETWORK;
    connected_ = WiFi.begin(network, WIFI_PASSWORD) == WL_CONNECTED && udp_.begin(kPort) == 1;
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
    udp_.write(frame, fss::kFrameSize);
    udp_.endPacket();
  }

 private:
  WiFiUDP udp_;
  IPAddress peer_;
  uint16_t peer_port_ = 0;
  bool connected_ = false;
};

// The computer at the end of a wire.
class WireBoard : public DueBoard {
 public:
  bool connect() {
    COMPUTER_LINE.begin(115200);
    return true;
  }
  bool online() { return true; }

  size_t receive(uint8_t* data, size_t) override {
    while (COMPUTER_LINE.available() > 0) {
      const uint8_t* frame = reader_.take(static_cast<uint8_t>(COMPUTER_LINE.read()));
      if (!frame) continue;
      memcpy(data, frame, fss::kFrameSize);
      return fss::kFrameSize;
    }
    return 0;
  }
  void answer() override {}
  void send(const uint8_t* frame) override {
    uint8_t bytes[fss::kStreamedSize];
    fss::to_stream(frame, bytes);
    if (COMPUTER_LINE.availableForWrite() < static_cast<int>(sizeof bytes)) return;
    COMPUTER_LINE.write(bytes, sizeof bytes);
  }

 private:
  fss::StreamReader reader_;
};
