"""Planning time: `python bench/bench_motion.py`.

Median and largest processor time of random requests, after the kernels are compiled. For
comparison, the time of reference methods: direct transcription by sequential linear programming
(SciPy's HiGHS), and exhaustive search.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test/support"))

from direct_transcription import direct_transcription
from workspace_oracle import exhaustive

from fss_arm_model.description import paper_arm
from fss_arm_motion.best_posture import BestPosture, best, velocity_ratio
from fss_arm_motion.limits import Limits, LimitSettings
from fss_arm_motion.plan import PlanError, Start
from fss_arm_motion.point_to_point import PointToPoint, point_to_point
from fss_arm_motion.reorientation import Reorientation, reorientation
from fss_arm_motion.tip_path import TipPath, tip_path
from fss_arm_motion.zero_reaction import ZeroReaction, zero_reaction

RUNS = 20
ARM = paper_arm()
POSTURES = np.radians([[-50, 55, 45, 40], [0, 0, 0, 0], [60, -60, -30, 80], [-30, 40, 30, 20]])


def measure(request: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor time [s], and the plan, or None if there is none."""
    start = time.process_time()
    try:
        plan = request()
    except PlanError:
        plan = None
    return time.process_time() - start, plan


def print_row(name: str, limit: float, requests: Iterator[Callable[[], Any]]) -> None:
    """Print the median and the largest time, and the number of requests with a plan."""
    results = [measure(request) for request in requests]
    times = [1e3 * seconds for seconds, _ in results]
    found = sum(plan is not None for _, plan in results)
    print(
        f"{name}: median {median(times):.1f} ms, slowest {max(times):.1f} ms "
        f"(limit {limit:g} ms), {found} of {len(results)} planned"
    )


def main() -> None:
    rng = np.random.default_rng(0)
    starts = [Start(ARM, q) for q in POSTURES]
    for start in starts[:1]:  # load the kernels
        point_to_point(start, PointToPoint((0.1, 0.2, 0.3, 0.4)))
        zero_reaction(start, ZeroReaction(direction=(1.0, 0.0, 0.0, 0.0)))
        tip_path(start, TipPath(by=(-0.1, 0.0)))
        reorientation(start, Reorientation(0.1))
        best(start, BestPosture())
    goals = rng.uniform(-1.4, 1.4, (RUNS, 4))
    print_row(
        "point to point",
        20,
        (
            lambda g=g, k=k: point_to_point(starts[k % 4], PointToPoint(tuple(g)))
            for k, g in enumerate(goals)
        ),
    )
    print_row(
        "zero reaction along a direction",
        200,
        (
            lambda u=u, k=k: zero_reaction(starts[k % 4], ZeroReaction(direction=tuple(u)))
            for k, u in enumerate(rng.standard_normal((RUNS, 4)))
        ),
    )
    print_row(
        "zero reaction to a goal",
        200,
        (
            lambda d=d: zero_reaction(
                starts[0], ZeroReaction(goal=tuple((POSTURES[0] + d).clip(-1.5, 1.5)))
            )
            for d in rng.uniform(-0.4, 0.4, (RUNS, 4))
        ),
    )
    print_row(
        "least rotation in 5 s",
        200,
        (
            lambda g=g: point_to_point(starts[0], PointToPoint(tuple(g), 5.0, least_rotation=True))
            for g in goals
        ),
    )
    turns = 2 * np.pi * rng.random(RUNS)
    print_row(
        "tip along a line of 0.3 m, or its possible part",
        200,
        (
            lambda a=a, k=k: tip_path(
                starts[3 * (k % 2)], TipPath(by=(0.3 * np.cos(a), 0.3 * np.sin(a)), partial=True)
            )
            for k, a in enumerate(turns)
        ),
    )
    print_row(
        "reorientation by 30 deg",
        2000,
        (
            lambda k=k: reorientation(starts[k % 4], Reorientation((-1) ** (k // 4) * np.pi / 6))
            for k in range(8)
        ),
    )
    compare()


def compare() -> None:
    """Compare with the reference methods: same requests, without rotors and body sizes."""
    settings = LimitSettings(
        share=1.0, rotor_inertia=0.0, base_radius=0.0, link_radius=0.0, margin=0.0
    )
    limits, rng = Limits.of(ARM, settings), np.random.default_rng(1)
    ours, reference_times, ratios = [], [], []
    for _ in range(6):
        first, last = rng.uniform(-1.3, 1.3, (2, 4))
        start = Start(ARM, first, limits=limits)
        seconds, plan = measure(partial(point_to_point, start, PointToPoint(tuple(last))))
        reference_time, reference = measure(
            partial(direct_transcription, ARM, limits, first, last, 40)
        )
        ours.append(seconds)
        reference_times.append(reference_time)
        ratios.append(plan.duration / reference)
    print(
        f"minimum time: ours {1e3 * median(ours):.1f} ms, direct transcription "
        f"{1e3 * median(reference_times):.0f} ms "
        f"({median(reference_times) / median(ours):.0f} times as long); "
        f"our motions take {min(ratios):.4f} to {max(ratios):.4f} of its duration"
    )
    start, position = Start(ARM, np.zeros(4), limits=limits), (0.9, 0.3)
    seconds, (_, ratio) = measure(lambda: best(start, BestPosture(0.8, position)))
    reference_time, reference_ratio = measure(
        lambda: exhaustive(
            ARM, limits.bounds, complex(*position), lambda q: velocity_ratio(ARM, q, 0.8)
        )
    )
    print(
        f"best posture at a position: ours {1e3 * seconds:.0f} ms, exhaustive "
        f"{1e3 * reference_time:.0f} ms ({reference_time / seconds:.1f} times as long); ratio "
        f"{ratio:.6f} and {reference_ratio:.6f} m"
    )


if __name__ == "__main__":
    main()
