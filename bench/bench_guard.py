"""Time of the guard's check of a streamed command, and of a path.

Arms with 4 and 12 links on a drifting base, with table edge and target: random commands, and random
paths of five knots in ten seconds, including rejected ones and ones that start too close. One core.
Limit for a streamed command: 1 ms for 4 links, 3 ms for 12.

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
    """Return the paper's arm, or one with n similar but shorter links, 3 m long in total."""
    arm = paper_arm()
    links = tuple(replace(arm.links[0], a=3.0 / n, b=1.5 / n) for _ in range(n))
    return arm if n == arm.n else replace(arm, links=links)


def check_times(guard: Guard, rng: np.random.Generator) -> tuple[float, float, bool]:
    """Return the times to check a command and a path [s], and True if both are accepted."""
    n = guard.arm.n
    state = {
        "base": rng.uniform([-0.5, -0.5, -np.pi], [0.5, 0.5, np.pi]),
        "twist": rng.normal(0.0, [0.03, 0.03, 0.05]),
        "target": [*rng.uniform(-1.8, 1.8, 2), 0.0],
    }
    q = rng.uniform(-1.0, 1.0, n) * rng.uniform(0.1, 1.0)
    qd, velocity = rng.uniform(-0.8, 0.8, (2, n))
    knots, rates = q + rng.uniform(-0.4, 0.4, (5, n)), rng.normal(0.0, 0.1, (5, n))
    start = time.perf_counter()
    clear = 0
    with suppress(GuardError):
        guard.check_command(q, qd, HORIZON, velocity=velocity, **state)
        clear += 1
    between = time.perf_counter()
    with suppress(GuardError):
        guard.check_path(TIMES, knots, rates, **state)
        clear += 1
    return between - start, time.perf_counter() - between, clear == 2


def main() -> None:
    print(f"{COUNT} checks, in us         p50    p99 largest")
    for n in (4, 12):
        guard, rng = Guard(arm_of(n)), np.random.default_rng(n)
        *times, clear = zip(*(check_times(guard, rng) for _ in range(COUNT + 1)), strict=True)
        for name, row in zip(("command", "path"), times, strict=True):
            # The first one loads the kernels.
            p50, p99, most = 1e6 * np.percentile(row[1:], [50, 99, 100])
            print(f"{n:2} links, {name:8}     {p50:8.0f} {p99:6.0f} {most:7.0f}")
        print(f"{n:2} links: {sum(clear)} pairs accepted")


if __name__ == "__main__":
    main()
