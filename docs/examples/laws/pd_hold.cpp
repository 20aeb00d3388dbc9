// PD law in C++, the same as pd_hold.py. Compile it:
//
//   c++ -O2 -ffp-contract=off -fPIC -shared -o libpd_hold.so pd_hold.cpp
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "law.h"

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kMass = 20.0, kInertia = 10.0;     // [kg], [kg m^2]
constexpr double kStiffness = 0.1, kDamping = 0.6;  // of the base per mass [1/s^2], [1/s]
constexpr double kMaxError[] = {0.03, 0.03, 0.05};  // [m], [m], [rad]
constexpr double kJointGain = 1.0, kMaxRate = 0.1;  // [1/s], [rad/s]

double limit(double value, double bound) { return std::clamp(value, -bound, bound); }

class PdHold {
public:
    void step(const law_inputs& in, law_outputs& out) {
        commandBase(in, out);
        if (!started_) std::copy_n(in.joint_angles, in.joints, start_.begin());
        started_ = true;
        out.joint_velocities_valid = 1;
        for (int i = 0; i < in.joints; i++)
            out.joint_velocities[i] = limit(kJointGain * (start_[i] - in.joint_angles[i]), kMaxRate);
    }

private:
    static void commandBase(const law_inputs& in, law_outputs& out) {
        std::array<double, 3> error, a;
        for (int i = 0; i < 3; i++) error[i] = in.reference_pose[i] - in.base_pose[i];
        error[2] -= 2.0 * kPi * std::nearbyint(error[2] / (2.0 * kPi));  // the shorter way
        for (int i = 0; i < 3; i++) {
            error[i] = limit(error[i], kMaxError[i]);
            a[i] = kStiffness * error[i] + kDamping * (in.reference_twist[i] - in.base_twist[i]);
        }
        const double c = std::cos(in.base_pose[2]), s = std::sin(in.base_pose[2]);
        out.wrench_valid = 1;
        out.wrench[0] = kMass * (c * a[0] + s * a[1]);
        out.wrench[1] = kMass * (c * a[1] - s * a[0]);
        out.wrench[2] = kInertia * a[2];
    }

    bool started_ = false;
    std::array<double, LAW_MAX_JOINTS> start_{};  // angles of the joints [rad]
};

std::unique_ptr<PdHold> law;

}  // namespace

void law_init(int32_t, double) { law = std::make_unique<PdHold>(); }
void law_step(const law_inputs* in, law_outputs* out) { law->step(*in, *out); }
void law_terminate() { law.reset(); }
