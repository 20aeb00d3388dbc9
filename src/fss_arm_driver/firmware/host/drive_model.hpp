// A servo drive with its motor at the other end of the serial line, as far as docs/start/hardware.md
// knows it: the ASCII protocol at its pace, the modes and the trapezoid of its profiles.
#pragma once

#include <stdint.h>

#include <deque>
#include <string>
#include <vector>

namespace fss {

class DriveModel {
 public:
  DriveModel() { reset(); }  // on, homed, its motor at rest

  // The computer's end of the line; times never run back [us].
  void set_baud(uint32_t baud, uint64_t now);
  void write(const uint8_t* data, size_t size, uint64_t now);
  size_t read(uint8_t* data, size_t room, uint64_t now);
  bool has_come(uint64_t now) const;  // whether there is something to read

  // What may happen to it.
  void power_cycle();
  void switch_off() { registers_[0x24] = 0; }
  void plug(bool in) { plugged_ = in; }
  void noise(const std::vector<uint8_t>& bytes, uint64_t now);  // towards the computer
  void fail_next(int error) { error_ = error; }                 // the next order, with this code
  void latch_faults(uint32_t bits);
  void push(double velocity) { velocity_ = velocity; }          // by hand [counts/s]
  void reference(bool is) { referenced_ = is; }
  void lack(uint8_t variable) { lacks_ = variable; }            // has none such
  void delay(uint64_t latency) { latency_ = latency; }          // from a line to its reply [us]
  void shake(bool on) { shakes_ = on; }                         // never measured at rest
  void report(uint32_t status) { reported_ = status; }          // these status bits, too

  double position() const { return position_; }  // [counts]
  double velocity() const { return velocity_; }  // [counts/s]
  int mode() const { return registers_[0x24]; }
  int32_t set_velocity() const { return mode() == 11 ? registers_[0x2f] : 0; }  // [0.1 counts/s]
  uint32_t baud() const { return baud_; }
  std::string take_orders();  // what came since the last call but for readings, or "-"

 private:
  struct Byte {
    uint64_t at;
    uint32_t baud;
    uint8_t value;
  };

  void reset();
  void advance(uint64_t now);
  void hear(const Byte& byte);
  void execute(const std::string& line, uint64_t now);
  std::string answer(const std::string& line);
  std::string get(uint8_t variable);
  std::string set(uint8_t variable, int32_t number);
  std::string trajectory(int32_t command);
  void step();
  void follow_profile();
  void approach(double velocity, double acceleration);
  uint32_t status() const;

  int32_t registers_[256] = {};
  std::string line_, orders_;
  std::deque<Byte> to_drive_, to_computer_;
  uint32_t computer_baud_ = 9600, baud_ = 9600;
  uint64_t sent_ = 0, answered_ = 0;  // when the wires are free again
  uint64_t now_ = 0;                  // of the motion
  uint64_t homed_ = 0;                // when the homing under way will have ended
  uint32_t reported_ = 0;
  uint64_t latency_ = 500;
  uint8_t lacks_ = 0;
  bool plugged_ = true, referenced_ = true, was_reset_ = false, moving_ = false, aborting_ = false,
       shakes_ = false;
  int error_ = 0;
  double position_ = 0.0, velocity_ = 0.0, target_ = 0.0, current_ = 0.0;
};

}  // namespace fss
