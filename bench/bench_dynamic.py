"""Time of the dynamic calibration, compared with scipy's least_squares over an integrated ODE.

Eight single-joint maneuvers of +-60 degrees, sampled as by telemetry at 5 Hz, are fitted to the
base's heading: first for one inertia shared by all links, then for all b and I. The peer has the
same residuals, guess and interpolated joint paths. It integrates the base's heading from momentum
conservation with a tolerance of 1e-8, with the inertia matrix of a compiled kernel. One core. The
floor of a prediction with sensitivities is the time of its multiplications and additions at the
core's peak, measured in the same run; the operations per node are counted in base_motion.

Then a Monte Carlo: calibrations of all b and I from headings with different noise. The floor of a
calibration is that of its predictions. All times are processor times.

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

from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.solve import solve
from fss_arm_model import base_motion, dynamics, joint_path
from fss_arm_model.choice import Choice
from fss_arm_model.description import paper_arm

ARM, N = paper_arm(), 4
NOISE = np.radians(1.54)  # of the base's rotation [rad]
OPERATIONS_PER_NODE = 93 * (N + 1)
DRAWS = 200  # of the Monte Carlo
PRIOR = {"b": 0.02, "I": 0.02}


def telemetry(joint: int, sense: float, others: np.ndarray) -> tuple[list, list, list]:
    """Return times, angles and rates of the joints' samples; each link has another phase."""
    times = [np.array([0.0, *np.arange(0.05 * i + 0.2, 3.0, 0.2), 3.0]) for i in range(N)]
    x = [t / 3.0 for t in times]
    reach = [np.radians(60.0) * sense if i == joint else 0.0 for i in range(N)]
    angles = [
        others[i] * (i != joint) + r * (6 * x[i] ** 2 - 4 * x[i] ** 3 - 1)
        for i, r in enumerate(reach)
    ]
    rates = [r * 12.0 * x[i] * (1.0 - x[i]) / 3.0 for i, r in enumerate(reach)]
    return times, angles, rates


def maneuvers() -> list[tuple[list, list, list]]:
    postures = np.radians([[40, -70, 60, -60], [-30, 60, -70, 50]])
    return [
        telemetry(j, sense, q) for sense, q in zip((1, -1), postures, strict=True) for j in range(N)
    ]


def prepare(samples: list[tuple[list, list, list]]) -> joint_path.Path:
    laws = [joint_path.sampled(*one) for one in samples]
    return joint_path.stack([joint_path.path(law, edges, [0.0, 3.0]) for law, edges in laws])


def problem(path: joint_path.Path, estimate: str) -> DynamicProblem:
    sigma = np.full((8, 2, 3), np.inf)
    sigma[..., 2] = NOISE / np.sqrt(2.0)
    poses = base_motion.base_poses(ARM.vector(), path, np.zeros(8))
    poses[:, 1, 2] += NOISE * np.random.default_rng(1).standard_normal(8)
    choice = Choice.of(estimate, N)
    prior = [np.inf if estimate == "I" else PRIOR[name[0]] for name in choice.names]
    none = np.zeros((5 * N + 6, 5 * N + 6))
    links = tuple(replace(link, inertia=0.05) for link in ARM.links)
    guess = replace(ARM, links=links)
    return DynamicProblem(path, poses, sigma, guess, choice, np.array(prior), none, np.zeros(3))


def solve_by_ode(case: DynamicProblem, samples: list[tuple[list, list, list]]) -> np.ndarray:
    laws = [joint_path.sampled(*one)[0] for one in samples]
    measured = np.diff(case.poses[..., 2], axis=1)[:, 0]
    has_prior = np.isfinite(case.prior)

    def turn(p: np.ndarray, law: joint_path.Law) -> float:
        def rate(t: float, theta: np.ndarray) -> np.ndarray:
            q, qd = law(np.array([t]))
            H = dynamics.inertia_matrix(p, np.concatenate([[0.0, 0.0], theta, q[0]]))
            return np.linalg.solve(H[:3, :3], -H[:3, 3:] @ qd[0])[2:]

        return float(solve_ivp(rate, (0.0, 3.0), [0.0], rtol=1e-8, atol=1e-10).y[0, -1])

    def residuals(x: np.ndarray) -> np.ndarray:
        p = case.vector(x)
        turns = [turn(p, law) for law in laws]
        prior_errors = ((x - case.guess) / case.prior)[has_prior]
        return np.concatenate([(measured - turns) / NOISE, prior_errors])

    return np.asarray(least_squares(residuals, case.guess, x_scale="jac").x)


def median_time(work: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of a call [s]."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return median(times)


def monte_carlo(case: DynamicProblem, path: joint_path.Path, draws: int, floor: float) -> None:
    """Print the time per calibration; `floor` [s] is the floor of one prediction."""
    poses = np.tile(base_motion.base_poses(ARM.vector(), path, np.zeros(8)), (draws, 1, 1, 1))
    poses[:, :, 1, 2] += NOISE * np.random.default_rng(2).standard_normal((draws, 8))
    start = time.process_time()
    results = [solve(replace(case, poses=one)) for one in poses]
    each = (time.process_time() - start) / draws
    floor_each = floor * np.mean([1 + one.minimum.iterations for one in results])
    print(
        f"{draws} calibrations: {1e6 * each:.0f} us each, at the core's peak "
        f"{1e6 * floor_each:.0f} us: {100.0 * floor_each / each:.0f} % of peak"
    )


def main() -> None:
    samples = maneuvers()
    path = prepare(samples)
    preparing = median_time(lambda: prepare(samples), 50)
    print(f"paths from telemetry, for 8 maneuvers: {1e3 * preparing:.2f} ms")
    p, rest = ARM.vector(), np.zeros(8)
    duration = median_time(lambda: base_motion.base_pose_sensitivities(p, path, rest), 200)
    nodes = path.marks[:, -1, -2].sum()
    floor = OPERATIONS_PER_NODE * nodes / peak()
    print(
        f"sensitivities at {nodes:.0f} nodes: {1e6 * duration:.0f} us, at the core's peak "
        f"{1e6 * floor:.1f} us: {100.0 * floor / duration:.0f} % of peak"
    )
    for estimate, limit in (("I", 2.0), ("b_i I_i", 10.0)):
        case = problem(path, estimate)
        # A fresh problem each time, as it keeps what it has computed.
        ours = median_time(lambda k=case: solve(replace(k)), 200)
        peers = median_time(lambda k=case: solve_by_ode(k, samples), 3)
        difference = np.abs(solve(case).values - solve_by_ode(case, samples)).max()
        print(
            f"{estimate:8}{len(case.names):2} parameters: {1e3 * ours:6.2f} ms (limit {limit:g}), "
            f"with paths {1e3 * (ours + preparing):6.2f} ms; scipy and ODE {1e3 * peers:8.1f} ms, "
            f"ratio {peers / ours:.0f} (at least 200), difference {difference:.1e}"
        )
    draws = int(sys.argv[1]) if sys.argv[1:] else DRAWS
    monte_carlo(problem(path, "b_i I_i"), path, draws, floor)


if __name__ == "__main__":
    main()
