"""Whether `design --goal` keeps its promise (python bench/bench_design.py [SEEDS]).

By seed: what a laboratory believes of its arm (the paper's description) is off by what it says it
may be, and b and I by more. Sixteen maneuvers are designed; the goal is to know each b as well as
they promise of the worst. The maneuvers that `design` then proposes are made on the simulated test
bed without ROS, by the links' protocol, with its default errors, on a table that is tilted, with a
base that drifts and is put back after every four. What the streams give is solved as `dynamic`
does.

Beside the time that is planned for each: deviations of b that the estimate reports by those
promised, least and largest; squares of its errors by those, of four b, whose mean is 1 if promised
deviations are those that there are, and the verdict.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from sim_goal import KEPT, rehearsed


def main():
    found = []
    for seed in range(1, 1 + int(sys.argv[1] if sys.argv[1:] else 20)):
        one = rehearsed(seed)
        found.append(one)
        print(
            f"{seed:3}  fixed {one.fixed:.2f} min; {one.count} maneuvers in {one.minutes:.2f} min, "
            f"simulated {one.simulated:.2f}; achieved by promised {min(one.ratios):.2f} to "
            f"{max(one.ratios):.2f}, errors squared {one.square:.2f}, {one.verdict}",
            flush=True,
        )
    kept = sum(max(abs(np.subtract(one.ratios, 1.0))) < KEPT for one in found)
    sooner = sum(one.minutes < one.fixed for one in found)
    squares = [one.square for one in found]
    error = np.std(squares) / np.sqrt(len(squares))
    print(
        f"kept within 20 %: {kept} of {len(found)}; sooner than 16 maneuvers: {sooner}; mean time "
        f"{np.mean([one.minutes for one in found]):.2f} of "
        f"{np.mean([one.fixed for one in found]):.2f} min; errors squared {np.mean(squares):.2f} "
        f"+- {error:.2f}"
    )


if __name__ == "__main__":
    main()
