"""Time that the guard takes for a command of a stream, and for a path.

Arms of 4 and of 12 links on a drifting base, with edge and target: random commands, and random
paths of five knots in ten seconds, those that are refused or begin too near included. One core;
of a stream, at most 1 ms is asked for 4 links and 3 ms for 12.

    OPENBLAS_NUM_THREADS=1 python bench/bench_guard.py
"""

import time
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.guard.guard import Guard, GuardError

COUNT = 2000
HORIZON, TIMES = 0.2, np.linspace(0.0, 10.0, 5)  # [s]


def arm_of(n: int) -> Arm:
    """The paper's arm, or one of n links like its own but shorter, of 3 m in all."""
    arm = paper_arm()
    links = tuple(replace(arm.links[0], a=3.0 / n, b=1.5 / n) for _ in range(n))
    return arm if n == arm.n else replace(arm, links=links)


def timed(guard: Guard, rng: np.random.Generator) -> tuple[float, float, bool]:
    """Times of a command's and of a path's check [s], and whether both are clear."""
    n = guard.arm.n
    known = {
        "base": rng.uniform([-0.5, -0.5, -np.pi], [0.5, 0.5, np.pi]),
        "twist": rng.normal(0.0, [0.03, 0.03, 0.05]),
        "target": [*rng.uniform(-1.8, 1.8, 2), 0.0],
    }
    q = rng.uniform(-1.0, 1.0, n) * rng.uniform(0.1, 1.0)
    qd, wanted = rng.uniform(-0.8, 0.8, (2, n))
    knots, rates = q + rng.uniform(-0.4, 0.4, (5, n)), rng.normal(0.0, 0.1, (5, n))
    begin = time.perf_counter()
    clear = 0
    with suppress(GuardError):
        guard.check_command(q, qd, HORIZON, velocity=wanted, **known)
        clear += 1
    between = time.perf_counter()
    with suppress(GuardError):
        guard.check_path(TIMES, knots, rates, **known)
        clear += 1
    return between - begin, time.perf_counter() - between, clear == 2


def main() -> None:
    print(f"{COUNT} each, in us           p50    p99    most")
    for n in (4, 12):
        guard, rng = Guard(arm_of(n)), np.random.default_rng(n)
        *times, clear = zip(*(timed(guard, rng) for _ in range(COUNT + 1)), strict=True)
        for words, row in zip(("command", "path"), times, strict=True):
            p50, p99, most = 1e6 * np.percentile(row[1:], [50, 99, 100])  # the first loads it
            print(f"{n:2} links, {words:8}     {p50:8.0f} {p99:6.0f} {most:7.0f}")
        print(f"{n:2} links: {sum(clear)} clear in both")


if __name__ == "__main__":
    main()
