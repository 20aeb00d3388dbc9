/* NMPC law in C for base and arm: the base follows its reference while the joints move to GOAL.
   Generate the solver and compile it:

   python nmpc.py
   cc -O1 -ffp-contract=off -fPIC -shared -o libnmpc.so nmpc.c nmpc_solver.c -lm */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "law.h"

#define JOINTS 4 /* STEPS and STEP as in nmpc.py */
#define STEPS 10
#define SIZE ((3 + JOINTS) * STEPS)
#define MAX_POINTERS 64 /* that the solver works with */
#define PI 3.14159265358979323846

#ifndef SPEED
#define SPEED 0.15 /* of the joints [rad/s]; 0: they stay */
#endif

static const double STEP = 0.4;                            /* [s] */
static const double GOAL[JOINTS] = {-0.6, 0.6, 0.6, -0.6}; /* [rad] */

int nmpc_solver(const double **given, double **results, long long *iw, double *w, int memory);
int nmpc_solver_work(long long *given, long long *results, long long *iw, long long *w);
int nmpc_solver_checkout(void);
void nmpc_solver_release(int memory);

static double controls[SIZE], next[SIZE], start[JOINTS], *work;
static long long sizes[4], *integers;
static int memory, is_started;

void law_init(int32_t joints, double period) {
    (void)period;
    nmpc_solver_work(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
    integers = malloc((size_t)sizes[2] * sizeof *integers);
    work = malloc((size_t)sizes[3] * sizeof *work);
    memory = nmpc_solver_checkout();
    memset(controls, 0, sizeof controls);
    is_started = 0;
    if (joints != JOINTS || sizes[0] > MAX_POINTERS || sizes[1] > MAX_POINTERS) abort();
}

void law_step(const law_inputs *in, law_outputs *out) {
    double desired[6 * STEPS], angles[JOINTS * STEPS], *results[MAX_POINTERS] = {next};
    const double *given[MAX_POINTERS] = {controls,         in->base_pose, in->base_twist, in->joint_angles,
                                         in->joint_rates, desired,       angles};
    if (!is_started) memcpy(start, in->joint_angles, sizeof start);
    is_started = 1;

    double turns = nearbyint((in->base_pose[2] - in->reference_pose[2]) / (2.0 * PI));
    for (int k = 0; k < STEPS; k++) {
        double *pose = desired + 6 * k, *twist = pose + 3;
        memcpy(twist, in->reference_twist, 3 * sizeof(double));
        for (int i = 0; i < 3; i++)
            pose[i] = in->reference_pose[i] + (k + 1) * STEP * twist[i];
        pose[2] += 2.0 * PI * turns;
        for (int i = 0; i < JOINTS; i++) {
            double reach = SPEED * (in->time + (k + 1) * STEP), way = GOAL[i] - start[i];
            angles[JOINTS * k + i] = start[i] + fmin(fmax(way, -reach), reach);
        }
    }
    nmpc_solver(given, results, integers, work, memory);
    memcpy(controls, next, sizeof controls);

    out->wrench_valid = out->joint_velocities_valid = 1;
    memcpy(out->wrench, controls, sizeof out->wrench);
    memcpy(out->joint_velocities, controls + 3, JOINTS * sizeof(double));
}

void law_terminate(void) {
    nmpc_solver_release(memory);
    free(integers);
    free(work);
}
