// The servo drive behind its ASCII protocol (Copley's, docs/start/hardware.md): one exchange at a time.
//
// The caller sets a goal. The commands that lead there follow from what the drive has acknowledged,
// so a lost reply or a drive that was off for a while needs no special case. Between commands the
// drive's state is read in rounds.
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "board.hpp"
#include "link_frame.hpp"

namespace fss {

// What the drive is to do, in the units of a command. Whatever asks for another mode than the
// present one is begun from rest.
struct Demand {
  enum Goal : uint8_t {
    Off,      // at once
    Release,  // decelerate, then off; off, too, if it does not come to rest
    Hold,     // decelerate, then hold that place
    Home,     // find the reference
    Current,
    Velocity,
    Position,
  };
  Goal goal = Release;
  int32_t set_point = 0;
  int32_t velocity = 0;
  int32_t acceleration = 0;  // 0: as the drive has it

  bool operator==(const Demand& other) const {
    return goal == other.goal && set_point == other.set_point && velocity == other.velocity &&
           acceleration == other.acceleration;
  }
};

struct Measurement {
  uint64_t clock = 0;  // when the position was read [us]
  int32_t position = 0, velocity = 0, current = 0;
  uint32_t status = 0;

  bool at_rest() const { return velocity > -kStill && velocity < kStill; }
  static constexpr int32_t kStill = 1000;  // slower is at rest [0.1 counts/s]; 2.6 mrad/s
};

class Drive {
 public:
  explicit Drive(Board& board) : board_(board) {}

  // Receives from the drive, and then sends to it.
  void listen(uint64_t now);
  void talk(uint64_t now);

  // Returns true if a new set point for the same goal would be sent now; kLead is the time from
  // then until half of its effect [us].
  bool is_open(uint64_t now) const;
  static constexpr uint32_t kLead = 8000;

  // From now on. The same demand again changes nothing, unless the drive refused it.
  void demand(const Demand& demand);

  // Those that are latched now, once it is off.
  void clear_faults() { clearing_ = faults_ != 0; }

  // Whether the drive answers, and has been measured since it does.
  bool answers() const { return phase_ == Phase::Running && measured_.clock != 0; }
  bool blocked() const;  // by a fault
  bool refuses() const { return refused_; }                    // the demand
  bool let_go() const { return demand_.goal == Demand::Off; }  // it refused even to hold

  Mode mode() const { return mode_; }
  const Measurement& measured() const { return measured_; }
  uint64_t position_clock() const { return position_clock_; }  // of its newest reading [us]
  uint32_t faults() const { return faults_; }                  // latched ones
  int32_t supply() const { return supply_; }                   // [0.1 V]
  int32_t temperature() const { return temperature_; }         // [deg C]
  // False while a command to home is pending or refused.
  bool referenced() const {
    const bool begun = demand_.goal == Demand::Home && done_;
    return referenced_ && (asked_.goal != Demand::Home || begun);
  }
  uint16_t homings() const { return homings_; }

 private:
  enum class Phase : uint8_t { Begin, Probe, Rate, Switch, Running };
  enum class Waiting : uint8_t { Nothing, Value, Ok };

  struct Write {  // variable 0: the trajectory command `t`
    uint8_t variable;
    int32_t value;
  };
  struct Plan {  // writes in their order
    Write writes[8];
    uint8_t size = 0;
    void add(uint8_t variable, int32_t value) { writes[size++] = {variable, value}; }
  };

  void begin(const Demand& demand);
  void receive(uint64_t now);
  void reply(uint64_t now);
  void take_value(int32_t value, uint64_t now);
  void end_round(uint64_t now);
  void take_mode(int32_t value);
  void take_ok();
  void take_error();
  void fail(uint64_t now);
  void connect(uint64_t now);
  void read_next(uint64_t now);
  bool order_next(uint64_t now);
  bool follow(const Plan& plan, uint64_t now);
  bool is_so(const Write& write) const;
  Plan brake() const;
  Plan program() const;
  bool at_rest() const;
  void get(uint8_t variable, uint64_t now);
  void order(Write write, uint64_t now);
  void send(const char* text, size_t size, uint64_t now);

  Board& board_;

  // The exchange under way.
  Phase phase_ = Phase::Begin;
  Waiting waiting_ = Waiting::Nothing;
  uint32_t baud_ = 9600;
  uint64_t asked_at_ = 0;
  uint64_t quiet_until_ = 0;  // nothing is sent, and received bytes are dropped
  uint64_t alive_ = 0;        // when it was last connected to or measured
  uint8_t variable_ = 0;      // that is read; 0: none, it is an order
  Write write_ = {};          // the order
  bool outdated_ = false;     // it belongs to an earlier demand
  char line_[24] = {};
  size_t line_size_ = 0;

  // What the drive is to do, and how far that has come.
  Demand demand_, asked_;
  bool refused_ = false;     // the last command
  bool pending_ = false;     // the last command is another set point for the same goal
  bool clearing_ = false;
  bool paused_ = false;      // no orders until it has been measured again
  bool braked_ = false;      // the brake commands are sent
  bool done_ = false;        // all commands are sent
  uint64_t braked_at_ = 0;
  uint64_t ordered_at_ = 0;  // the last order
  uint8_t step_ = 0;         // of the plan that is followed
  Mode mode_ = Mode::Off;    // as acknowledged or read
  int32_t acceleration_ = 0, deceleration_ = 0;  // limits as acknowledged; 0: not known

  // What it reports.
  uint8_t turn_ = 0, slow_turn_ = 0;
  int32_t round_[8] = {};
  uint64_t position_clock_ = 0;
  Measurement measured_;
  uint32_t faults_ = 0;
  int32_t supply_ = 0, temperature_ = 0, abort_ = 0;
  bool referenced_ = false;
  uint16_t homings_ = 0;
};

}  // namespace fss
