// The Arduino Due with its shields: Wi-Fi, RS-232, and the load cell amplifier on two pins.
#pragma once

#include <Arduino.h>
#include <WiFi.h>
#include <WiFiUdp.h>

#include "board.hpp"
#include "frame.hpp"
#include "settings.hpp"

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

  // Takes seconds, in which nothing else happens.
  bool connect() {
    char network[] = WIFI_NETWORK;
    if (WiFi.begin(network, WIFI_PASSWORD) != WL_CONNECTED) return false;
    online_ = udp_.begin(kPort) == 1;
    return online_;
  }

  // The time since the start [us]. To be called at least once an hour, as micros() wraps.
  uint64_t now() {
    now_ += static_cast<uint32_t>(micros() - static_cast<uint32_t>(now_));
    return now_;
  }

  size_t receive(uint8_t* data, size_t room) override {
    if (!online_ || udp_.parsePacket() <= 0) return 0;
    const int size = udp_.read(data, room);
    udp_.flush();  // what did not fit
    return size > 0 ? static_cast<size_t>(size) : 0;
  }
  void answer() override {
    peer_ = udp_.remoteIP();
    peer_port_ = udp_.remotePort();
  }
  void send(const uint8_t* frame) override {
    if (!online_ || peer_port_ == 0 || !udp_.beginPacket(peer_, peer_port_)) return;
    udp_.write(frame, fss::kFrameSize);
    udp_.endPacket();
  }

  void set_baud(uint32_t baud) override { kDriveLine.begin(baud); }
  size_t read(uint8_t* data, size_t room) override {
    size_t size = 0;
    while (size < room && kDriveLine.available() > 0) {
      data[size++] = static_cast<uint8_t>(kDriveLine.read());
    }
    return size;
  }
  bool write(const uint8_t* data, size_t size) override {
    if (kDriveLine.availableForWrite() < static_cast<int>(size)) return false;
    return kDriveLine.write(data, size) == size;
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
  WiFiUDP udp_;
  IPAddress peer_;
  uint16_t peer_port_ = 0;
  bool online_ = false;
  uint64_t now_ = 0;
};
