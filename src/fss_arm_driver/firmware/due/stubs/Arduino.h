// As much of the Arduino Due's core and of the Wi-Fi shield's library as the sketches use, declared
// so that they can be compiled without them. Nothing here runs.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

constexpr int LOW = 0, HIGH = 1, INPUT = 0, OUTPUT = 1, INPUT_PULLUP = 2;
constexpr int A0 = 54, A1 = 55, A2 = 56, A3 = 57, A4 = 58;
constexpr int WL_CONNECTED = 3;
constexpr uint32_t ID_TC3 = 30, ID_TRNG = 41, VARIANT_MCK = 84000000;
constexpr uint32_t TC_CMR_TCCLKS_TIMER_CLOCK1 = 0, TC_CMR_WAVSEL_UP_RC = 2u << 13, TC_CMR_WAVE = 1u << 15,
                   TC_IER_CPCS = 1u << 4;

struct Trng;
extern Trng* const TRNG;

struct Tc {
  struct {
    uint32_t TC_IER;
  } TC_CHANNEL[3];
};
extern Tc* const TC1;
enum IRQn_Type { TC3_IRQn = 30 };

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
void TC3_Handler();
}
void TC_Configure(Tc* timer, uint32_t channel, uint32_t mode);
void TC_SetRC(Tc* timer, uint32_t channel, uint32_t value);
void TC_Start(Tc* timer, uint32_t channel);
uint32_t TC_GetStatus(Tc* timer, uint32_t channel);
void NVIC_SetPriority(IRQn_Type interrupt, uint32_t priority);
void NVIC_EnableIRQ(IRQn_Type interrupt);
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
