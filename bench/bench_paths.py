"""How closely links follow paths in time (python bench/bench_paths.py [runs]).

Four links of the simulated test bed with its default errors, the drivers' sessions and the links'
electronics, without ROS and as fast as it computes. Each run is a path of 10 s and 6 knots, others
for each link, given 2.5 s before it begins; over ways of 2 to 10 ms there and back, and with faults
as well: 20 % loss, 0 to 60 ms more each way, and an outage of 1 s at some time in the path. The
clocks have been compared for 30 s before.

- error: true joint angle against the path, by the computer's clock, each 10 ms from begin to end
- by encoder: the same of what the encoder reads, whose error is the harmonic drive's
- start: from the first link's beginning to the last one's, by the links' clocks
- missed: knots at which a link does not follow, 30 ms later (its clock, and steps of 10 ms)
"""

import random
import statistics
import sys
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.table import Table

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from driver_path import SECOND, PathBed, path_at, spread

TIMES = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
DEGREE = 57.29577951308232
CASES = {
    "no faults": {},
    "20 % loss, 30 +- 30 ms, 1 s outage": {"loss": 0.2, "delay": 0.03, "jitter": 0.03},
}


def knots(rng):
    """Positions and velocities that keep the joint's limits; from rest to rest at 0."""
    q = [0.0, *(rng.uniform(-0.5, 0.5) for _ in TIMES[2:]), 0.0]
    qd = [0.0, *((b - a) / 4.0 for a, b in zip(q, q[2:], strict=False)), 0.0]
    return q, qd


def run(seed, faults):
    """Errors of all joints [deg], by truth and by encoder, spread [ms], and knots missed."""
    rng = random.Random(seed)
    bed = PathBed(seed=seed)
    bed.fault(**faults)
    bed.armed(settle=30.0)
    paths = [knots(rng) for _ in bed.sessions]
    begin, outage = bed.now + 5 * SECOND // 2, rng.uniform(0.0, 9.0)
    bed.give(1, begin, TIMES, *zip(*paths, strict=True))
    bed.follow(1)
    bed.run(0.5)
    started = spread(bed)
    true, read, missed = [], [], 0
    while (t := (bed.frame - begin) / SECOND) <= TIMES[-1]:
        if faults:
            bed.fault(loss=1.0 if outage <= t < outage + 1.0 else faults["loss"])
        for i, (q, qd) in enumerate(paths if t >= 0.0 else ()):
            wanted = path_at(t, TIMES, q, qd)
            true.append(DEGREE * abs(bed.bed.plant.q[3 + i] - wanted))
            read.append(DEGREE * abs(bed.reading(i) - wanted))
        bed.step()
        if any(0.03 <= (bed.frame - begin) / SECOND - knot < 0.04 for knot in TIMES):
            missed += sum(bed.electronics(i).paths.followed != 1 for i in range(len(paths)))
    return true, read, started, missed


def main():
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    table = Table("", "error p50", "largest [deg]", "by encoder p50", "largest [deg]",
                  "start p50", "largest [ms]", "knots missed", title=f"{runs} runs")  # fmt: skip
    begun = perf_counter()
    for name, faults in CASES.items():
        results = [run(seed, faults) for seed in range(runs)]
        true, read = ([x for r in results for x in r[k]] for k in (0, 1))
        starts, missed = [r[2] for r in results], sum(r[3] for r in results)
        figures = [f"{f(x):.3f}" for x in (true, read, starts) for f in (statistics.median, max)]
        table.add_row(name, *figures, f"{missed} of {runs * 4 * len(TIMES)}")
    Console(width=140).print(table)
    print(f"{perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
