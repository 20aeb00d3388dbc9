// As much of the Arduino Due's core and of the Wi-Fi shield's library as due.ino uses, declared so
// that it can be compiled without them. Nothing here runs.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

constexpr int LOW = 0, HIGH = 1, OUTPUT = 1, INPUT_PULLUP = 2, A0 = 54;
constexpr int WL_CONNECTED = 3;
constexpr uint32_t ID_TRNG = 41;

struct Trng;
extern Trng* const TRNG;

extern "C" {
void pinMode(uint32_t pin, uint32_t mode);
void digitalWrite(uint32_t pin, uint32_t level);
int digitalRead(uint32_t pin);
uint32_t analogRead(uint32_t pin);
void analogReadResolution(int bits);
uint32_t micros();
uint32_t millis();
uint32_t pmc_enable_periph_clk(uint32_t id);
void watchdogEnable(uint32_t milliseconds);
void watchdogReset();
void watchdogSetup();
}
void delayMicroseconds(uint32_t microseconds);
uint32_t __get_PRIMASK();
void noInterrupts();
void interrupts();
void trng_enable(Trng* generator);
uint32_t trng_read_output_data(Trng* generator);
void NVIC_SystemReset();

struct USARTClass {
  void begin(uint32_t baud);
  int available();
  int availableForWrite();
  int read();
  size_t write(const uint8_t* data, size_t size);
};
extern USARTClass Serial1, Serial2;

class IPAddress {
  uint32_t address_ = 0;
};

struct WiFiClass {
  int begin(char* network, const char* password);
  uint8_t status();
};
extern WiFiClass WiFi;

struct WiFiUDP {
  uint8_t begin(uint16_t port);
  int parsePacket();
  int read(unsigned char* data, size_t size);
  void flush();
  IPAddress remoteIP();
  uint16_t remotePort();
  int beginPacket(IPAddress address, uint16_t port);
  size_t write(const uint8_t* data, size_t size);
  int endPacket();

 private:
  uint8_t state_[8];
};

void setup();
void loop();
