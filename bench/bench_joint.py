"""The joint estimate: how good, and how fast, beside chained calibrations and scipy.

    OPENBLAS_NUM_THREADS=1 python bench/bench_joint.py [SEEDS]

First what is known of b, I and the base from the same data by each way: 13 rests, 16 maneuvers and
4 drifts of arms drawn anew for each seed, with rests that see the end effector as a good laboratory
does, and as the paper's. NEES is the normalized squared error a parameter, 1 if it is honest:

    forgotten  rests, then maneuvers, the arm's kinematics taken to be known to 0.5 mm and 0.1 deg
    chained    the covariance of the kinematic result handed over with its description
    along      the same, lengths and angles estimated anew with that as their prior
    joint      all in one
    paths      the same, the base seen on its way, too, twice a second (`path_rate`), with joints
               that do not give
    paper      the paper's own experiment: 13 rests as its own, then 8 maneuvers of one joint each,
               seen by how far the base turned, with what geometry tells of b and I

Then the processor's time for 100 rests, 100 maneuvers and 20 drifts: of the solution alone, and of
all that `joint` does after reading, the stages that it begins from included; of more sessions and
more links; and of scipy's least_squares over integrated ODEs. The peer knows the sparsity of the
problem, and has the same residuals and interpolated joint paths. It is given a tenth of the data,
and one iteration, which it begins from our solution: that the two agree is seen by the step that it
would take next. It is counted with as many iterations as ours had.

"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from calib_joint import (
    ARM,
    DYNAMIC,
    KINEMATIC,
    PAPER,
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
    papers,
    rests,
)

from fss_arm_calib.joint.calibrate import Session, begin, calibrate, problem_of, stages
from fss_arm_calib.joint.problem import solve
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINED
from fss_arm_model import dynamics as model
from fss_arm_model.drifting import whole
from fss_arm_model.joint_path import sampled
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import system_com

ALONG = replace(DYNAMIC, estimate=f"{DYNAMIC.estimate} a_i theta_0_i mount")
NAMES = [f"{kind}_{i}" for kind in "bI" for i in range(1, 5)] + ["I_0", "x_com", "y_com"]
JOINT = JointSettings(zero_deviation=0.02)
PEER = 10  # the peer's share of the data, one in so many


def joined(data, seen):
    """The joint estimate."""
    settings = {**SETTINGS, "kinematic": seen}
    return solve(problem_of([data], ARM, JOINT, JOINED, settings), bounded=False)


def ways(seed, seen):
    """NEES and deviations of NAMES by each way."""
    rng, own = np.random.default_rng(seed), np.random.default_rng([1, seed])
    truth, acting = draw_arm(rng), SURROUNDINGS * rng.standard_normal(5)
    data = {
        "kinematic": rests(truth, 13, rng, s=seen),
        "dynamic": maneuvers(truth, 16, rng, acting),
        "drift": drifts(truth, 4, rng, acting),
    }
    arm = kinematics(data["kinematic"], s=seen)
    found = {
        "forgotten": dynamics(data["dynamic"], forgotten(arm)),
        "chained": dynamics(data["dynamic"], arm),
        "along": dynamics(data["dynamic"], arm, ALONG),
        "joint": joined(data, seen),
        "paths": joined({**data, "dynamic": maneuvers(truth, 16, own, acting, along=True)}, seen),
        "paper": dynamics(
            papers(truth, own), kinematics(rests(truth, 13, own, s=ROUGH), s=ROUGH), PAPER
        ),
    }
    judged = {}
    for way, r in found.items():
        at = [r.problem.names.index(name) for name in NAMES]
        C = r.covariance[np.ix_(at, at)]
        judged[way] = nees(NAMES, r.values[at], C, truth), np.sqrt(np.diag(C))
    return judged


def compare(seeds):
    for words, seen in (("1 mm, 0.1 deg", KINEMATIC), ("17.7 mm, 0.7 deg", ROUGH)):
        trials = [ways(seed, seen) for seed in range(seeds)]
        print(f"rests of {words}, {seeds} seeds; deviations in mm and g m^2")
        print(f"{'':10}{'NEES':>14}" + "".join(f"{name:>8}" for name in NAMES))
        for way in trials[0]:
            squares = [trial[way][0] for trial in trials]
            error = np.std(squares) / np.sqrt(seeds)
            sigma = 1e3 * np.median([trial[way][1] for trial in trials], axis=0)
            numbers = "".join(f"{x:8.2f}" for x in sigma)
            print(f"{way:10}{np.mean(squares):7.2f} +- {error:4.2f}{numbers}")


def clocked(work):
    """The least of three times of the processor [s], and what came of it."""
    spans = []
    for _ in range(3):
        start = time.process_time()
        found = work()
        spans.append(time.process_time() - start)
    return min(spans), found


def sessions(count, guess=ARM, share=1):
    """Days that share 100 rests, 100 maneuvers and 20 drifts."""
    rng = np.random.default_rng(0)
    truth = draw_arm(rng, guess)
    each = [number // (count * share) for number in (100, 100, 20)]
    return [day(truth, rng, each, 0.02 * (k < count - 1), k).data for k in range(count)]


def longer(n):
    """An arm of so many links, lighter by as much."""
    links = [ARM.links[min(i, 3) if i < n - 1 else 3] for i in range(n)]
    small = [
        replace(
            k, a=k.a * 4 / n, b=k.b * 4 / n, mass=k.mass * 4 / n, inertia=k.inertia * (4 / n) ** 3
        )
        for k in links
    ]
    return replace(ARM, links=tuple(small))


def ours(data, guess=ARM):
    """Times of the solution, and of all after reading [s]."""
    parts = [Session(str(k), one) for k, one in enumerate(data)]
    whole_time, outcome = clocked(lambda: calibrate(parts, guess, JOINT, JOINED, SETTINGS))
    found = [stages(one, guess, JOINED, SETTINGS) for one in parts]

    def solved():
        problem = problem_of([one.used for one in found], guess, JOINT, JOINED, SETTINGS)
        return solve(problem, begin(problem, [one.arm for one in found]))

    span, result = clocked(solved)
    return span, whole_time, result, outcome


class Peer:
    """Residuals of all unknowns, the base's motion integrated; one session."""

    def __init__(self, data):
        self.data = data
        self.known = problem_of([data], ARM, JOINT, JOINED, SETTINGS)
        self.laws = [sampled(one.times, one.q, one.qd)[0] for one in data["dynamic"]]
        evidence = self.known.sessions[0]
        self.rests, self.sigma = evidence["kinematic"].problem, evidence["dynamic"].problem.sigma
        self.drift_sigma = evidence["drift"].sigma

    def moved(self, p, one, law, own, g):
        """Poses of the base at a maneuver's marks."""

        def state(t, pose):
            q, qd = law(np.array([t]))
            return np.concatenate([pose, q[0]]), qd[0]

        def rate(t, pose):
            at, qd = state(t, pose)
            H = model.inertia_matrix(p, at)
            M = H[0, 0]
            c = system_com(p, at) - pose[:2]
            P = own[3:5] + M * g * (t - one.marks[0])
            spin = own[5] + c[0] * P[1] - c[1] * P[0]  # about the base's origin
            return np.linalg.solve(H[:3, :3], np.array([*P, spin]) - H[:3, 3:] @ qd)

        span = one.marks[0], one.marks[-1]
        return solve_ivp(rate, span, own[:3], t_eval=one.marks, rtol=1e-8, atol=1e-10).y.T

    def drifted(self, p, one, own, acting):
        """Poses of the base while it drifts."""
        M, K, *com = whole(p, one.q)
        c, g, (tau, kappa, d) = complex(*com), complex(*acting[:2]), acting[2:]

        def rate(_, s):
            arm = np.exp(1j * s[4]) * c
            v = complex(s[2], s[3]) - 1j * s[5] * arm
            a = g - d / M * v
            turn = tau - kappa * s[5] + d * (arm.conjugate() * v).imag
            return [s[2], s[3], a.real, a.imag, s[5], turn / K]

        lever = np.exp(1j * own[2]) * c
        z, u = complex(*own[:2]) + lever, complex(*own[3:5]) + 1j * own[5] * lever
        first = [z.real, z.imag, u.real, u.imag, own[2], own[5]]
        span = one.times[0], one.times[-1]
        s = solve_ivp(rate, span, first, t_eval=one.times, rtol=1e-8, atol=1e-10).y
        x = s[0] + 1j * s[1] - np.exp(1j * s[4]) * c
        return np.column_stack([x.real, x.imag, s[4]])

    def __call__(self, x):
        """All residuals, in deviations."""
        known, size = self.known, len(self.known.names)
        z = known.z(x, 0)
        p, acting = z[:-5], z[-5:]
        every = x[known.own(0).stop :].reshape(-1, 6)
        off = self.rests.tip - tip_in_base(p, self.rests.q)
        found = [(off / self.rests.sigma).ravel()]
        beliefs = np.array([DYNAMIC.momentum_deviation] * 2 + [DYNAMIC.spin_deviation])
        for k, (one, law) in enumerate(zip(self.data["dynamic"], self.laws, strict=True)):
            poses = self.moved(p, one, law, every[k], acting[:2])
            found += [((one.poses - poses) / self.sigma[k]).ravel(), every[k][3:] / beliefs]
        for k, one in enumerate(self.data["drift"]):
            own = every[len(self.laws) + k]
            poses = self.drifted(p, one, own, acting)
            found.append(((one.poses - poses) / self.drift_sigma[k]).ravel())
        found.append(x[known.own(0)] / known.own_deviations(0))
        found.append(known.prior_rows @ (known.guess - x[:size]))
        return np.concatenate(found)

    def sparsity(self):
        """Which residuals depend on which unknowns."""
        first = self.known.own(0).stop
        few, m = self.rests.tip.size, self.sigma[0].size + 3
        count = len(self.laws)
        drifting = [sigma.size for sigma in self.drift_sigma]
        rows = few + m * count + sum(drifting) + first - len(self.known.names)
        rows += len(self.known.believed)
        found = lil_matrix((rows, first + 6 * (count + len(drifting))))
        found[:, :first] = 1
        at = few
        for k, size in enumerate([m] * count + drifting):
            found[at : at + size, first + 6 * k : first + 6 * (k + 1)] = 1
            at += size
        return found

    def one_step(self, x, scale):
        """Of least_squares from x: residuals and their Jacobian, by differences in groups.

        It is asked in units of `scale`, which differences and integration errors go well with.
        """
        return least_squares(
            lambda u: self(x + scale * (u - 1.0)), np.ones(len(x)), jac_sparsity=self.sparsity(),
            tr_solver="lsmr", max_nfev=1, diff_step=0.5,
        )  # fmt: skip


def race():
    (data,) = sessions(1, share=PEER)
    span, _, result, _ = ours([data])
    peer, x = Peer(data), result.minimum.x
    p, own = len(peer.known.names), peer.known.own(0)
    scale = np.full(len(x), 1e-3)
    scale[:p], scale[own] = np.sqrt(np.diag(result.covariance)), result.session(0)[1]
    start = time.process_time()
    found = peer.one_step(x, scale)
    step = (time.process_time() - start) * result.minimum.iterations
    J = found.jac.toarray()
    C = np.linalg.inv(J.T @ J)
    away = np.abs(C @ found.grad / np.sqrt(np.diag(C))).max()
    alike = np.sqrt(np.diag(C)[:p])  # in units of ours
    print(
        f"a tenth: {span:.3f} s, scipy and ODE {step:.1f} s for as many iterations, ratio "
        f"{step / span:.0f} (at least 100); there the peer's costs are {2.0 * found.cost:.3f} and "
        f"ours {result.minimum.cost:.3f}, its next step at most {away:.1e} deviations, its "
        f"deviations {alike.min():.3f} to {alike.max():.3f} of ours"
    )


def main():
    compare(int(sys.argv[1]) if sys.argv[1:] else 20)
    for n, count in ((4, 1), (4, 2), (4, 5), (12, 1)):
        guess = ARM if n == 4 else longer(n)
        span, everything, result, outcome = ours(sessions(count, guess), guess)
        print(
            f"{n:2} links, {count} sessions, {len(result.minimum.x)} unknowns: solution "
            f"{span:.2f} s, all after reading {everything:.2f} s, "
            f"{result.minimum.iterations} iterations, {outcome.verdict}",
            flush=True,
        )
    race()


if __name__ == "__main__":
    main()
