"""Time of the dynamic calibration, beside scipy's least_squares over an integrated ODE.

Eight single-joint maneuvers of +-60 degrees as telemetry gives them, at 5 Hz, fitted by the base's
heading: once for the inertia that all links share, once for all b and I. The peer has the same
residuals, guess and interpolated joint paths; it integrates the base's heading from momentum
conservation, with the inertia matrix from a compiled kernel, to 1e-8. One core. The floor of a
prediction with its sensitivities is the time of its multiplications and additions at the core's
peak, measured in the same run; those of a node of the paths are counted from base_motion.

Then a Monte Carlo: calibrations of all b and I from headings with other noise each, side by side
and, of some, one after the other. The floor of one is that of the predictions that it takes. All
times are the processor's.

    OPENBLAS_NUM_THREADS=1 python bench/bench_dynamic.py [DRAWS]
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median

import numpy as np
from peak import peak
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fss_arm_calib.dynamic.parameters import Choice
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.solve import solve, solve_all
from fss_arm_model import base_motion, dynamics, joint_path
from fss_arm_model.description import paper_arm

ARM, N = paper_arm(), 4
NOISE = np.radians(1.54)  # of the base's turn
OPERATIONS = 93 * (N + 1)  # of a node
DRAWS, SINGLE = 10_000, 200  # of the Monte Carlo, and of these one after the other
PRIOR = {"b": 0.02, "I": 0.02}


def telemetry(joint: int, way: float, others: np.ndarray) -> tuple[list, list, list]:
    """Times, angles and rates of the joints' samples, each link in its own phase."""
    times = [np.array([0.0, *np.arange(0.05 * i + 0.2, 3.0, 0.2), 3.0]) for i in range(N)]
    x = [t / 3.0 for t in times]
    reach = [np.radians(60.0) * way if i == joint else 0.0 for i in range(N)]
    angles = [others[i] * (i != joint) + r * (6 * x[i] ** 2 - 4 * x[i] ** 3 - 1)
              for i, r in enumerate(reach)]  # fmt: skip
    rates = [r * 12.0 * x[i] * (1.0 - x[i]) / 3.0 for i, r in enumerate(reach)]
    return times, angles, rates


def maneuvers() -> list[tuple[list, list, list]]:
    postures = np.radians([[40, -70, 60, -60], [-30, 60, -70, 50]])
    return [
        telemetry(j, way, q) for way, q in zip((1, -1), postures, strict=True) for j in range(N)
    ]


def prepare(samples: list[tuple[list, list, list]]) -> joint_path.Path:
    laws = [joint_path.sampled(*one) for one in samples]
    return joint_path.stack([joint_path.path(law, edges, [0.0, 3.0]) for law, edges in laws])


def problem(path: joint_path.Path, words: str) -> DynamicProblem:
    sigma = np.full((8, 2, 3), np.inf)
    sigma[..., 2] = NOISE / np.sqrt(2.0)
    poses = base_motion.base_poses(ARM.vector(), path, np.zeros(8))
    poses[:, 1, 2] += NOISE * np.random.default_rng(1).standard_normal(8)
    choice = Choice.of(words, N)
    prior = [np.inf if words == "I" else PRIOR[name[0]] for name in choice.names]
    none = np.zeros((5 * N + 6, 5 * N + 6))
    links = tuple(replace(link, inertia=0.05) for link in ARM.links)
    guess = replace(ARM, links=links)
    return DynamicProblem(path, poses, sigma, guess, choice, np.array(prior), none, np.zeros(3))


def by_ode(known: DynamicProblem, samples: list[tuple[list, list, list]]) -> np.ndarray:
    laws = [joint_path.sampled(*one)[0] for one in samples]
    seen = np.diff(known.poses[..., 2], axis=1)[:, 0]
    weak = np.isfinite(known.prior)

    def turn(p: np.ndarray, law: joint_path.Law) -> float:
        def rate(t: float, theta: np.ndarray) -> np.ndarray:
            q, qd = law(np.array([t]))
            H = dynamics.inertia_matrix(p, np.concatenate([[0.0, 0.0], theta, q[0]]))
            return np.linalg.solve(H[:3, :3], -H[:3, 3:] @ qd[0])[2:]

        return float(solve_ivp(rate, (0.0, 3.0), [0.0], rtol=1e-8, atol=1e-10).y[0, -1])

    def residuals(x: np.ndarray) -> np.ndarray:
        p = known.vector(x)
        turns = [turn(p, law) for law in laws]
        off = ((x - known.guess) / known.prior)[weak]
        return np.concatenate([(seen - turns) / NOISE, off])

    return np.asarray(least_squares(residuals, known.guess, x_scale="jac").x)


def timed(work: Callable[[], object], repeats: int) -> float:
    """Median of the processor time of a call [s]."""
    work()
    spans = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        spans.append(time.process_time() - begin)
    return median(spans)


def monte_carlo(known: DynamicProblem, path: joint_path.Path, draws: int, floor: float) -> None:
    """Print what a calibration takes of many, of which `floor` [s] is for each prediction."""
    poses = np.tile(base_motion.base_poses(ARM.vector(), path, np.zeros(8)), (draws, 1, 1, 1))
    poses[:, :, 1, 2] += NOISE * np.random.default_rng(2).standard_normal((draws, 8))
    solve_all(known, poses[:10])
    begin = time.process_time()
    results = solve_all(known, poses)
    each = (time.process_time() - begin) / draws
    begin = time.process_time()
    alone = [solve(replace(known, poses=one)) for one in poses[:SINGLE]]
    single = (time.process_time() - begin) / len(alone)
    pairs = zip(results, alone, strict=False)
    apart = max(np.abs((a.values - b.values) / b.deviations).max() for a, b in pairs)
    least = floor * np.mean([1 + one.minimum.iterations for one in results])
    print(
        f"{draws} calibrations side by side: {1e6 * each:.0f} us each, at the core's peak "
        f"{1e6 * least:.0f} us: {100.0 * least / each:.0f} % of peak; one after the other "
        f"{1e6 * single:.0f} us, apart by {apart:.0e} deviations"
    )


def main() -> None:
    samples = maneuvers()
    path = prepare(samples)
    preparing = timed(lambda: prepare(samples), 50)
    print(f"paths from telemetry, once for 8 maneuvers: {1e3 * preparing:.2f} ms")
    p, rest = ARM.vector(), np.zeros(8)
    taken = timed(lambda: base_motion.base_pose_sensitivities(p, path, rest), 200)
    nodes = path.marks[:, -1, -2].sum()
    floor = OPERATIONS * nodes / peak()
    print(
        f"sensitivities at {nodes:.0f} nodes: {1e6 * taken:.0f} us, at the core's peak "
        f"{1e6 * floor:.1f} us: {100.0 * floor / taken:.0f} % of peak"
    )
    for words, limit in (("I", 2.0), ("b_i I_i", 10.0)):
        known = problem(path, words)
        # A fresh problem each time, as it keeps what it has computed.
        ours = timed(lambda k=known: solve(replace(k)), 200)
        peers = timed(lambda k=known: by_ode(k, samples), 3)
        apart = np.abs(solve(known).values - by_ode(known, samples)).max()
        print(
            f"{words:8}{len(known.names):2} parameters: {1e3 * ours:6.2f} ms (at most {limit:g}), "
            f"with paths {1e3 * (ours + preparing):6.2f} ms; scipy and ODE {1e3 * peers:8.1f} ms, "
            f"ratio {peers / ours:.0f} (at least 200), apart by {apart:.1e}"
        )
    draws = int(sys.argv[1]) if sys.argv[1:] else DRAWS
    monte_carlo(problem(path, "b_i I_i"), path, draws, floor)


if __name__ == "__main__":
    main()
