"""Check that `design --goal` reaches its goal (python bench/bench_design.py [SEEDS]).

For each seed, the description of the arm (the paper's) has random errors of its stated deviations,
and larger ones in b and I. Sixteen maneuvers are designed; the goal is the predicted deviation of
their worst b, for each b. The maneuvers that `design` then proposes run on the simulated test bed
without ROS, over the links' protocol, with its default errors, on a tilted table. The base drifts
and is put back after every four maneuvers. The streams are solved as by `dynamic`.

Printed for each seed: the planned times; the smallest and largest ratio of achieved to predicted
deviations of b; the mean square of the errors divided by the predicted deviations (1 if these are
correct); and the verdict.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from sim_goal import KEPT, rehearsed


def main():
    results = []
    for seed in range(1, 1 + int(sys.argv[1] if sys.argv[1:] else 20)):
        one = rehearsed(seed)
        results.append(one)
        print(
            f"{seed:3}  fixed {one.fixed:.2f} min; {one.count} maneuvers in {one.minutes:.2f} min, "
            f"simulated {one.simulated:.2f}; achieved / predicted {min(one.ratios):.2f} to "
            f"{max(one.ratios):.2f}, squared errors {one.square:.2f}, {one.verdict}",
            flush=True,
        )
    kept = sum(max(abs(np.subtract(one.ratios, 1.0))) < KEPT for one in results)
    faster = sum(one.minutes < one.fixed for one in results)
    squares = [one.square for one in results]
    error = np.std(squares) / np.sqrt(len(squares))
    print(
        f"within 20 % of the goal: {kept} of {len(results)}; faster than 16 maneuvers: {faster}; "
        f"mean time "
        f"{np.mean([one.minutes for one in results]):.2f} of "
        f"{np.mean([one.fixed for one in results]):.2f} min; squared errors {np.mean(squares):.2f} "
        f"+- {error:.2f}"
    )


if __name__ == "__main__":
    main()
