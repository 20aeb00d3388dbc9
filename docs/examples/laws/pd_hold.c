/* PD law in C, the same as pd_hold.py. Compile it:

   cc -O2 -ffp-contract=off -fPIC -shared -o libpd_hold.so pd_hold.c -lm */
#include <math.h>

#include "law.h"

#define PI 3.14159265358979323846

static const double MASS = 20.0, INERTIA = 10.0;      /* [kg], [kg m^2] */
static const double STIFFNESS = 0.1, DAMPING = 0.6;   /* of the base per mass [1/s^2], [1/s] */
static const double MAX_OFFSET = 0.03;                /* of the position error [m] */
static const double MAX_TURN = 0.05;                  /* of the heading error [rad] */
static const double JOINT_GAIN = 1.0, MAX_RATE = 0.1; /* [1/s], [rad/s] */

static int started;
static double start[LAW_MAX_JOINTS]; /* angles of the joints [rad] */

static double limit(double value, double bound) {
    return fmin(fmax(value, -bound), bound);
}

void law_init(int32_t joints, double period) {
    (void)joints;
    (void)period;
    started = 0;
}

void law_step(const law_inputs *in, law_outputs *out) {
    const double *pose = in->base_pose, *twist = in->base_twist;
    const double *desired = in->reference_pose, *desired_twist = in->reference_twist;
    double error_x = limit(desired[0] - pose[0], MAX_OFFSET);
    double error_y = limit(desired[1] - pose[1], MAX_OFFSET);
    double turn = desired[2] - pose[2];
    turn = limit(turn - 2.0 * PI * nearbyint(turn / (2.0 * PI)), MAX_TURN); /* the shorter way */
    double a_x = STIFFNESS * error_x + DAMPING * (desired_twist[0] - twist[0]);
    double a_y = STIFFNESS * error_y + DAMPING * (desired_twist[1] - twist[1]);
    double a_turn = STIFFNESS * turn + DAMPING * (desired_twist[2] - twist[2]);
    double c = cos(pose[2]), s = sin(pose[2]);
    out->wrench_valid = 1;
    out->wrench[0] = MASS * (c * a_x + s * a_y);
    out->wrench[1] = MASS * (c * a_y - s * a_x);
    out->wrench[2] = INERTIA * a_turn;

    for (int i = 0; !started && i < in->joints; i++)
        start[i] = in->joint_angles[i];
    started = 1;
    out->joint_velocities_valid = 1;
    for (int i = 0; i < in->joints; i++)
        out->joint_velocities[i] = limit(JOINT_GAIN * (start[i] - in->joint_angles[i]), MAX_RATE);
}

void law_terminate(void) {}
