"""Whether verdicts say what went wrong, on bags of MuJoCo's (python bench/bench_causes.py [GOOD]).

Arms of 3 and 6 unlike links, each with the description that its laboratory has, default options.

    wrong   bags that something is wrong with, of each kind on both arms, 66 in all: how many pass
            (none may), and how many verdicts have the cause first
    good    GOOD bags (50) of each arm and kind of calibration: how many pass, how many verdicts
            accuse, how many have a chi-square in its band (99.8 %), and the errors of those that
            pass: NEES is the error by its covariance, a parameter: 1 is honest
"""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import chi2

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from foreign_bags import DYNAMIC, KINEMATIC, arm, make

from fss_arm_calib.acceptance import CAUSE, PASS
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_model.layout import kinematic_index, kinematic_names
from fss_arm_model.parameters import parameter_names
from fss_arm_model.parameters import values as dynamic_values

SIZES = (3, 6)
FLIGHTS = 5  # of each arm and kind, flown by so many arms


def solved(n, seed, dynamic, kind=None, noise=0):
    with TemporaryDirectory() as folder:
        bag, description = make(Path(folder), n, seed, dynamic, kind, noise)
        calibration = KINDS["dynamic" if dynamic else "kinematic"]
        settings = calibration.settings(arm=str(description), **(kind.options if kind else {}))
        return solve_bag(calibration, bag, settings)


def wrong():
    named, passed, total = 0, 0, 0
    for dynamic, kinds in ((False, KINEMATIC), (True, DYNAMIC)):
        for kind in kinds:
            for n in SIZES:
                outcome = solved(n, 1, dynamic, kind)
                found = kind.named(outcome.reasons)
                named, passed, total = named + found, passed + (outcome.verdict == PASS), total + 1
                what = "dynamic" if dynamic else "kinematic"
                print(
                    f"{what:9} {n} links  {kind.name:22} {outcome.verdict:13} "
                    f"{'named' if found else 'MISSED':6}  {outcome.reasons[0][:110]}",
                    flush=True,
                )
    print(f"{total} wrong bags: {passed} passed, cause first in {named}", flush=True)


def error(outcome, truth, dynamic):
    """Of each parameter that the truth has, and its covariance."""
    if dynamic:
        known = dict(zip(parameter_names(truth.n), dynamic_values(truth), strict=True))
    else:
        values = truth.vector()[kinematic_index(truth.n)]
        known = dict(zip(kinematic_names(truth.n), values, strict=True))
    which = [k for k, name in enumerate(outcome.names) if name in known]
    off = np.array([outcome.values[k] - known[outcome.names[k]] for k in which])
    angles = np.array([outcome.estimate.units[k] == "rad" for k in which])
    off[angles] = (off[angles] + np.pi) % (2 * np.pi) - np.pi
    return off, outcome.covariance[np.ix_(which, which)]


def good(count):
    for dynamic in (False, True):
        for n in SIZES:
            passed, accused, band, nees = 0, 0, 0, []
            for k in range(count):
                seed = 1 + k % FLIGHTS
                outcome = solved(n, seed, dynamic, noise=1 + k)
                e = outcome.estimate
                low, high = chi2.interval(0.998, e.degrees_of_freedom)
                passed += outcome.verdict == PASS
                band += low <= e.chi_square <= high
                accused += any(check.name == CAUSE for check in outcome.checks)
                if outcome.verdict != PASS:  # at a bound, a parameter has no covariance
                    print(f"  bag {k}: {outcome.verdict}: {outcome.reason[:300]}", flush=True)
                    continue
                off, covariance = error(outcome, arm(n, seed), dynamic)
                nees.append(float(off @ np.linalg.solve(covariance, off)) / len(off))
            print(
                f"{'dynamic' if dynamic else 'kinematic':9} {n} links  {count} good bags: "
                f"{passed} passed, {accused} accused, chi-square in its band in {band}, "
                f"NEES {np.mean(nees):.2f} +- {np.std(nees) / len(nees) ** 0.5:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    os.nice(5)
    if "good" not in sys.argv:
        wrong()
    if "wrong" not in sys.argv:
        good(int(sys.argv[-1]) if sys.argv[-1].isdigit() else 50)
