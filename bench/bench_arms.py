"""Calibrate arms of 2 to 8 different links with default settings (python bench/bench_arms.py [N]).

The bags are made with MuJoCo, of N (20) random arms of each size: rests with cameras of 1 mm and
0.5 degrees, maneuvers, and descriptions with inertias wrong by up to a quarter. Each dynamic
calibration starts from the description.

Exits with 1 if a calibration does not pass, a parameter is off by more than 5 deviations, or NEES
(normalized squared error per parameter) of a size exceeds its 99 % band. It may be lower: priors
are wider than the errors.
"""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import chi2

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from foreign_bags import COARSE, arm, make

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_model.parameters import parameter_names, values

DYNAMIC = KINDS["dynamic"]
SIZES = range(2, 9)
MAX_ERROR = 5.0  # [deviations]


def calibrate(n, seed):
    """Return the outcome of a random arm, and the normalized squared errors and their number."""
    with TemporaryDirectory() as folder:
        bag, description = make(Path(folder), n, seed, True, None, seed, COARSE)
        outcome = solve_bag(DYNAMIC, bag, DYNAMIC.settings(arm=str(description)))
    true = dict(zip(parameter_names(n), values(arm(n, seed)), strict=True))
    finite = np.isfinite(outcome.deviations)
    known = [k for k, name in enumerate(outcome.names) if name in true and finite[k]]
    error = np.array([outcome.values[k] - true[outcome.names[k]] for k in known])
    largest = float(np.max(np.abs(error / outcome.deviations[known]), initial=0.0))
    squares = error @ np.linalg.solve(outcome.covariance[np.ix_(known, known)], error)
    return outcome, largest, float(squares), len(error)


def main(seeds):
    good = True
    print("links  passed  NEES (99 % band below)  largest [deviations]  inertias not determined")
    for n in SIZES:
        passed, worst, squares, count, lost = 0, 0.0, 0.0, 0, 0
        for seed in range(1, seeds + 1):
            outcome, largest, own_squares, own_count = calibrate(n, seed)
            if outcome.verdict != PASS:
                print(f"  {n} links, seed {seed}: {outcome.verdict}: {outcome.reason[:200]}")
                continue
            passed, worst = passed + 1, max(worst, largest)
            squares, count = squares + own_squares, count + own_count
            lost += len(outcome.estimate.unmeasured)
        limit = chi2.ppf(0.995, count) / count
        print(
            f"{n:5}  {passed:2} of {seeds:2}  {squares / count:.2f} ({limit:.2f})"
            f"{worst:26.1f}{lost:21} of {n * seeds}",
            flush=True,
        )
        good &= passed == seeds and worst < MAX_ERROR and squares / count < limit
    return 0 if good else 1


if __name__ == "__main__":
    os.nice(5)
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 20))
