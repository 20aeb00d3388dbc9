"""Tracking errors of links on timed paths (python bench/bench_paths.py [runs]).

Four links of the simulated test bed with its default errors, sessions of the drivers and
electronics of the links run without ROS, as fast as possible. Each run has a different path of 10 s
and 6 knots for each link, sent 2.5 s before its start. Datagrams take 2 to 10 ms in each direction;
with faults, also 20 % loss, 0 to 60 ms more, and an outage of 1 s at a random time in the path. The
clocks are compared for 30 s before.

- error: true joint angle minus path, by the computer's clock, every 10 ms
- by encoder: the same for the encoder reading, which has the error of the harmonic drive
- start: time from the start of the first link to that of the last one
- missed: knots at which a link does not follow the path 30 ms later
"""

import random
import statistics
import sys
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.table import Table

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from driver_path import PathBed, path_at, spread

from fss_arm_model.units import SECOND

TIMES = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
DEGREE = 57.29577951308232
CASES = {
    "no faults": {},
    "20 % loss, 30 +- 30 ms, 1 s outage": {"loss": 0.2, "delay": 0.03, "jitter": 0.03},
}


def random_knots(rng):
    """Return positions and velocities within the joint limits, from rest to rest at 0."""
    q = [0.0, *(rng.uniform(-0.5, 0.5) for _ in TIMES[2:]), 0.0]
    qd = [0.0, *((b - a) / 4.0 for a, b in zip(q, q[2:], strict=False)), 0.0]
    return q, qd


def run(seed, faults):
    """Return joint errors by truth and by encoder [deg], start spread [ms], missed knots."""
    rng = random.Random(seed)
    bed = PathBed(seed=seed)
    bed.fault(**faults)
    bed.armed(settle=30.0)
    paths = [random_knots(rng) for _ in bed.sessions]
    start, outage = bed.now + 5 * SECOND // 2, rng.uniform(0.0, 9.0)
    bed.give(1, start, TIMES, *zip(*paths, strict=True))
    bed.follow(1)
    bed.run(0.5)
    start_spread = spread(bed)
    by_truth, by_encoder, missed = [], [], 0
    while (t := (bed.frame - start) / SECOND) <= TIMES[-1]:
        if faults:
            bed.fault(loss=1.0 if outage <= t < outage + 1.0 else faults["loss"])
        for i, (q, qd) in enumerate(paths if t >= 0.0 else ()):
            target = path_at(t, TIMES, q, qd)
            by_truth.append(DEGREE * abs(bed.bed.plant.q[3 + i] - target))
            by_encoder.append(DEGREE * abs(bed.reading(i) - target))
        bed.step()
        if any(0.03 <= (bed.frame - start) / SECOND - knot < 0.04 for knot in TIMES):
            missed += sum(bed.electronics(i).paths.followed != 1 for i in range(len(paths)))
    return by_truth, by_encoder, start_spread, missed


def main():
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    table = Table(
        "",
        "error p50",
        "largest [deg]",
        "by encoder p50",
        "largest [deg]",
        "start p50",
        "largest [ms]",
        "knots missed",
        title=f"{runs} runs",
    )
    start_time = perf_counter()
    for name, faults in CASES.items():
        results = [run(seed, faults) for seed in range(runs)]
        by_truth, by_encoder = ([x for r in results for x in r[k]] for k in (0, 1))
        starts, missed = [r[2] for r in results], sum(r[3] for r in results)
        figures = [
            f"{f(x):.3f}" for x in (by_truth, by_encoder, starts) for f in (statistics.median, max)
        ]
        table.add_row(name, *figures, f"{missed} of {runs * 4 * len(TIMES)}")
    Console(width=140).print(table)
    print(f"{perf_counter() - start_time:.0f} s")


if __name__ == "__main__":
    main()
