"""Accuracy and speed of the joint estimate, compared with chained calibrations and scipy.

    OPENBLAS_NUM_THREADS=1 python bench/bench_joint.py [SEEDS]

First, the accuracy of b, I and the base by each method from the same data: 13 rests, 16 maneuvers
and 4 drifts of a random arm for each seed, with pose errors in the rests as in a good laboratory,
and as in the paper. NEES is the normalized squared error per parameter; 1 is consistent.

    forgotten  rests, then maneuvers; kinematics assumed to be known within 0.5 mm and 0.1 deg
    chained    maneuvers with the description and covariance of the kinematic result
    along      as chained, but lengths and angles are estimated again with that prior
    joint      all in one problem
    paths      as joint, with base poses during the motions, twice a second (`path_rate`), and rigid
               joints
    paper      the paper's experiment: 13 rests, then 8 maneuvers of one joint each, measured by the
               rotation of the base, with priors from geometry for b and I

Then the processor time for 100 rests, 100 maneuvers and 20 drifts: of the solution alone, and of
everything that `joint` does after reading, including the stages of its initial guess; with more
sessions and more links; and of scipy's least_squares over integrated ODEs. The peer uses the
sparsity of the problem, the same residuals and interpolated joint paths. It gets a tenth of the
data, and one iteration that starts at our solution: its next step shows whether both agree. Its
time is multiplied by our number of iterations.
"""

import sys
import time
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from calib_joint import (
    ARM,
    BIN,
    DYNAMIC,
    KINEMATIC,
    ROUGH,
    SETTINGS,
    SURROUNDINGS,
    day,
    draw_arm,
    drifts,
    dynamics,
    forgotten,
    kinematics,
    maneuvers,
    nees,
    rests,
)

from fss_arm_calib.dynamic.settings import HEADING, DynamicSettings
from fss_arm_calib.joint.calibrate import (
    Session,
    calibrate,
    initial_unknowns,
    problem_of,
    run_stages,
)
from fss_arm_calib.joint.problem import solve
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES
from fss_arm_model import dynamics as model
from fss_arm_model.drifting import single_body
from fss_arm_model.joint_path import sampled
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import system_com

ALONG = replace(DYNAMIC, estimate=f"{DYNAMIC.estimate} a_i theta_0_i mount")
COMPARED = [f"{kind}_{i}" for kind in "bI" for i in range(1, 5)] + ["I_0", "x_com", "y_com"]
JOINT = JointSettings(zero_deviation=0.02)
PEER_SHARE = 10  # the peer gets 1 / PEER_SHARE of the data
# The paper's maneuvers: rotation of the base, at rest before, on a level table; priors of b and I
# from geometry, without which they are not determined.
PAPER = DynamicSettings(
    residuals=HEADING,
    heading_deviation=radians(1.54) / 2**0.5,
    fresh_rate=1.0 / BIN,
    momentum_deviation=0.0,
    spin_deviation=0.0,
    tilt_deviation=0.0,
    priors=f"{DYNAMIC.priors} b_i",
)


def papers(arm, rng):
    """Return the paper's eight maneuvers: each joint from -60 to 60 degrees, from two postures."""
    ends = np.repeat(np.radians(rng.uniform(-75.0, 75.0, (2, 1, arm.n))), arm.n, axis=0)
    ends = np.repeat(ends, 2, axis=1)
    for k, way in enumerate(ends):
        way[:, k % arm.n] = np.radians([-60.0, 60.0]) * (1.0 if k < arm.n else -1.0)
    s = replace(PAPER, position_deviation=ROUGH.position_deviation)
    return maneuvers(arm, len(ends), rng, np.zeros(2), 0, s, ends, BIN)


def solve_joint(data, pose_settings):
    """Return the joint estimate."""
    settings = {**SETTINGS, "kinematic": pose_settings}
    return solve(problem_of([data], ARM, JOINT, JOINT_SOURCES, settings), bounded=False)


def run_methods(seed, pose_settings):
    """Return NEES and deviations of the COMPARED parameters by each method."""
    rng, other_rng = np.random.default_rng(seed), np.random.default_rng([1, seed])
    truth, surroundings = draw_arm(rng), SURROUNDINGS * rng.standard_normal(5)
    data = {
        "kinematic": rests(truth, 13, rng, s=pose_settings),
        "dynamic": maneuvers(truth, 16, rng, surroundings),
        "drift": drifts(truth, 4, rng, surroundings),
    }
    arm = kinematics(data["kinematic"], s=pose_settings)
    found = {
        "forgotten": dynamics(data["dynamic"], forgotten(arm)),
        "chained": dynamics(data["dynamic"], arm),
        "along": dynamics(data["dynamic"], arm, ALONG),
        "joint": solve_joint(data, pose_settings),
        "paths": solve_joint(
            {**data, "dynamic": maneuvers(truth, 16, other_rng, surroundings, along=True)},
            pose_settings,
        ),
        "paper": dynamics(
            papers(truth, other_rng),
            kinematics(rests(truth, 13, other_rng, s=ROUGH), s=ROUGH),
            PAPER,
        ),
    }
    scores = {}
    for method, r in found.items():
        at = [r.problem.names.index(name) for name in COMPARED]
        C = r.covariance[np.ix_(at, at)]
        scores[method] = nees(COMPARED, r.values[at], C, truth), np.sqrt(np.diag(C))
    return scores


def compare(seeds):
    for label, pose_settings in (("1 mm, 0.1 deg", KINEMATIC), ("17.7 mm, 0.7 deg", ROUGH)):
        trials = [run_methods(seed, pose_settings) for seed in range(seeds)]
        print(f"rests of {label}, {seeds} seeds; deviations in mm and g m^2")
        print(f"{'':10}{'NEES':>14}" + "".join(f"{name:>8}" for name in COMPARED))
        for method in trials[0]:
            squares = [trial[method][0] for trial in trials]
            error = np.std(squares) / np.sqrt(seeds)
            sigma = 1e3 * np.median([trial[method][1] for trial in trials], axis=0)
            numbers = "".join(f"{x:8.2f}" for x in sigma)
            print(f"{method:10}{np.mean(squares):7.2f} +- {error:4.2f}{numbers}")


def best_time(work):
    """Return the smallest of three processor times [s], and the result."""
    spans = []
    for _ in range(3):
        start = time.process_time()
        found = work()
        spans.append(time.process_time() - start)
    return min(spans), found


def sessions(count, guess=ARM, share=1):
    """Return `count` sessions with 100 rests, 100 maneuvers and 20 drifts in total."""
    rng = np.random.default_rng(0)
    truth = draw_arm(rng, guess)
    each = [number // (count * share) for number in (100, 100, 20)]
    return [day(truth, rng, each, 0.02 * (k < count - 1), k).data for k in range(count)]


def arm_of(n):
    """Return an arm of n links with the length and mass of four."""
    links = [ARM.links[min(i, 3) if i < n - 1 else 3] for i in range(n)]
    small = [
        replace(
            k, a=k.a * 4 / n, b=k.b * 4 / n, mass=k.mass * 4 / n, inertia=k.inertia * (4 / n) ** 3
        )
        for k in links
    ]
    return replace(ARM, links=tuple(small))


def time_ours(data, guess=ARM):
    """Return the times of the solution and of everything after reading [s], and both results."""
    parts = [Session(str(k), one) for k, one in enumerate(data)]
    whole_time, outcome = best_time(lambda: calibrate(parts, guess, JOINT, JOINT_SOURCES, SETTINGS))
    found = [run_stages(one, guess, JOINT_SOURCES, SETTINGS) for one in parts]

    def solved():
        problem = problem_of([one.used for one in found], guess, JOINT, JOINT_SOURCES, SETTINGS)
        return solve(problem, initial_unknowns(problem, [one.arm for one in found]))

    span, result = best_time(solved)
    return span, whole_time, result, outcome


class Peer:
    """Residuals of one session as a function of all unknowns, with an integrated base motion."""

    def __init__(self, data):
        self.data = data
        self.known = problem_of([data], ARM, JOINT, JOINT_SOURCES, SETTINGS)
        self.laws = [sampled(one.times, one.q, one.qd)[0] for one in data["dynamic"]]
        evidence = self.known.sessions[0]
        self.rests, self.sigma = evidence["kinematic"].problem, evidence["dynamic"].problem.sigma
        self.drift_sigma = evidence["drift"].sigma

    def maneuver_poses(self, p, one, law, start, g):
        """Return the poses of the base at a maneuver's marks."""

        def state(t, pose):
            q, qd = law(np.array([t]))
            return np.concatenate([pose, q[0]]), qd[0]

        def rate(t, pose):
            at, qd = state(t, pose)
            H = model.inertia_matrix(p, at)
            M = H[0, 0]
            c = system_com(p, at) - pose[:2]
            P = start[3:5] + M * g * (t - one.marks[0])
            spin = start[5] + c[0] * P[1] - c[1] * P[0]  # about the base's origin
            return np.linalg.solve(H[:3, :3], np.array([*P, spin]) - H[:3, 3:] @ qd)

        span = one.marks[0], one.marks[-1]
        return solve_ivp(rate, span, start[:3], t_eval=one.marks, rtol=1e-8, atol=1e-10).y.T

    def drift_poses(self, p, one, start, surroundings):
        """Return the poses of the base during a drift."""
        M, K, *com = single_body(p, one.q)
        c, g, (tau, kappa, d) = complex(*com), complex(*surroundings[:2]), surroundings[2:]

        def rate(_, s):
            arm = np.exp(1j * s[4]) * c
            v = complex(s[2], s[3]) - 1j * s[5] * arm
            a = g - d / M * v
            turn = tau - kappa * s[5] + d * (arm.conjugate() * v).imag
            return [s[2], s[3], a.real, a.imag, s[5], turn / K]

        lever = np.exp(1j * start[2]) * c
        z, u = complex(*start[:2]) + lever, complex(*start[3:5]) + 1j * start[5] * lever
        first = [z.real, z.imag, u.real, u.imag, start[2], start[5]]
        span = one.times[0], one.times[-1]
        s = solve_ivp(rate, span, first, t_eval=one.times, rtol=1e-8, atol=1e-10).y
        x = s[0] + 1j * s[1] - np.exp(1j * s[4]) * c
        return np.column_stack([x.real, x.imag, s[4]])

    def __call__(self, x):
        """Return all residuals, in standard deviations."""
        known, size = self.known, len(self.known.names)
        z = known.z(x, 0)
        p, surroundings = z[:-5], z[-5:]
        every = x[known.session_slice(0).stop :].reshape(-1, 6)
        off = self.rests.tip - tip_in_base(p, self.rests.q)
        found = [(off / self.rests.sigma).ravel()]
        beliefs = np.array([DYNAMIC.momentum_deviation] * 2 + [DYNAMIC.spin_deviation])
        for k, (one, law) in enumerate(zip(self.data["dynamic"], self.laws, strict=True)):
            poses = self.maneuver_poses(p, one, law, every[k], surroundings[:2])
            found += [((one.poses - poses) / self.sigma[k]).ravel(), every[k][3:] / beliefs]
        for k, one in enumerate(self.data["drift"]):
            start = every[len(self.laws) + k]
            poses = self.drift_poses(p, one, start, surroundings)
            found.append(((one.poses - poses) / self.drift_sigma[k]).ravel())
        found.append(x[known.session_slice(0)] / known.session_deviations(0))
        found.append(known.prior_rows @ (known.guess - x[:size]))
        return np.concatenate(found)

    def sparsity(self):
        """Return the sparsity of the Jacobian of the residuals."""
        first = self.known.session_slice(0).stop
        rest_rows, m = self.rests.tip.size, self.sigma[0].size + 3
        count = len(self.laws)
        drifting = [sigma.size for sigma in self.drift_sigma]
        rows = rest_rows + m * count + sum(drifting) + first - len(self.known.names)
        rows += len(self.known.prior_indices)
        found = lil_matrix((rows, first + 6 * (count + len(drifting))))
        found[:, :first] = 1
        at = rest_rows
        for k, size in enumerate([m] * count + drifting):
            found[at : at + size, first + 6 * k : first + 6 * (k + 1)] = 1
            at += size
        return found

    def one_step(self, x, scale):
        """Return least_squares after one step from x, with a grouped finite-difference Jacobian.

        Unknowns are in units of `scale`, which suits the differences and integration errors.
        """
        return least_squares(
            lambda u: self(x + scale * (u - 1.0)),
            np.ones(len(x)),
            jac_sparsity=self.sparsity(),
            tr_solver="lsmr",
            max_nfev=1,
            diff_step=0.5,
        )


def compare_with_peer():
    (data,) = sessions(1, share=PEER_SHARE)
    span, _, result, _ = time_ours([data])
    peer, x = Peer(data), result.minimum.x
    p, session = len(peer.known.names), peer.known.session_slice(0)
    scale = np.full(len(x), 1e-3)
    scale[:p], scale[session] = np.sqrt(np.diag(result.covariance)), result.session(0)[1]
    start = time.process_time()
    found = peer.one_step(x, scale)
    step = (time.process_time() - start) * result.minimum.iterations
    J = found.jac.toarray()
    C = np.linalg.inv(J.T @ J)
    next_step = np.abs(C @ found.grad / np.sqrt(np.diag(C))).max()
    ratios = np.sqrt(np.diag(C)[:p])  # relative to ours
    print(
        f"a tenth of the data: {span:.3f} s, scipy and ODE {step:.1f} s for as many iterations, "
        f"ratio {step / span:.0f} (at least 100); cost of the peer {2.0 * found.cost:.3f}, ours "
        f"{result.minimum.cost:.3f}; "
        f"its next step at most {next_step:.1e} deviations; its deviations {ratios.min():.3f} to "
        f"{ratios.max():.3f} of ours"
    )


def main():
    compare(int(sys.argv[1]) if sys.argv[1:] else 20)
    for n, count in ((4, 1), (4, 2), (4, 5), (12, 1)):
        guess = ARM if n == 4 else arm_of(n)
        span, total, result, outcome = time_ours(sessions(count, guess), guess)
        print(
            f"{n:2} links, {count} sessions, {len(result.minimum.x)} unknowns: solution "
            f"{span:.2f} s, everything after reading {total:.2f} s, "
            f"{result.minimum.iterations} iterations, {outcome.verdict}",
            flush=True,
        )
    compare_with_peer()


if __name__ == "__main__":
    main()
