"""Check that verdicts name the cause of a fault (python bench/bench_causes.py [GOOD|early]).

The bags are made with MuJoCo. `early` makes no bags: it checks the causes that a node names after a
few rests, of arms with 4 to 8 links: how many of the errors are named, how many by another cause,
and how many good observations are accused.

Arms with 3 and 6 different links, each with its laboratory's description; default options.

    wrong   174 faulty bags, one of each kind on both arms: how many pass (none may), and how many
            verdicts name the cause first
    good    GOOD bags (50) of each arm and calibration: how many pass, how many verdicts name a
            cause, how many have a chi-square in its 99.8 % band, and the NEES of those that pass
            (normalized squared error per parameter; 1: the covariance is consistent)
"""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import chi2

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from early_causes import ERRORS, cause_of, observed
from foreign_bags import arm, make
from laboratory_errors import DYNAMIC, KINEMATIC

from fss_arm_calib.acceptance import CAUSE, PASS
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_model.layout import kinematic_index, kinematic_names
from fss_arm_model.parameters import parameter_names
from fss_arm_model.parameters import values as dynamic_values

SIZES = (3, 6)
EARLY_SIZES, EARLY_SEEDS = range(4, 9), 5  # all kinds of errors differ from four links on
SEEDS = 5  # arms of each size and calibration


def solve_made_bag(n, seed, dynamic, kind=None, noise=0):
    with TemporaryDirectory() as folder:
        bag, description = make(Path(folder), n, seed, dynamic, kind and kind.spoil, noise)
        calibration = KINDS["dynamic" if dynamic else "kinematic"]
        settings = calibration.settings(arm=str(description), **(kind.options if kind else {}))
        return solve_bag(calibration, bag, settings)


def check_faulty_bags():
    named, passed, total = 0, 0, 0
    for dynamic, kinds in ((False, KINEMATIC), (True, DYNAMIC)):
        for kind in kinds:
            for n in SIZES:
                outcome = solve_made_bag(n, 1, dynamic, kind)
                found = kind.named(outcome.reasons, n)
                named, passed, total = named + found, passed + (outcome.verdict == PASS), total + 1
                calibration = "dynamic" if dynamic else "kinematic"
                print(
                    f"{calibration:9} {n} links  {kind.name:22} {outcome.verdict:13} "
                    f"{'named' if found else 'MISSED':6}  {outcome.reasons[0][:110]}",
                    flush=True,
                )
    print(f"{total} faulty bags: {passed} passed, cause named first in {named}", flush=True)


def parameter_error(outcome, truth, dynamic):
    """Return the errors of the parameters with a known true value, and their covariance."""
    if dynamic:
        true_values = dict(zip(parameter_names(truth.n), dynamic_values(truth), strict=True))
    else:
        values = truth.vector()[kinematic_index(truth.n)]
        true_values = dict(zip(kinematic_names(truth.n), values, strict=True))
    indices = [k for k, name in enumerate(outcome.names) if name in true_values]
    off = np.array([outcome.values[k] - true_values[outcome.names[k]] for k in indices])
    angles = np.array([outcome.estimate.units[k] == "rad" for k in indices])
    off[angles] = (off[angles] + np.pi) % (2 * np.pi) - np.pi
    return off, outcome.covariance[np.ix_(indices, indices)]


def check_good_bags(count):
    for dynamic in (False, True):
        for n in SIZES:
            passed, accused, band, nees = 0, 0, 0, []
            for k in range(count):
                seed = 1 + k % SEEDS
                outcome = solve_made_bag(n, seed, dynamic, noise=1 + k)
                e = outcome.estimate
                low, high = chi2.interval(0.998, e.degrees_of_freedom)
                passed += outcome.verdict == PASS
                band += low <= e.chi_square <= high
                accused += any(check.name == CAUSE for check in outcome.checks)
                if outcome.verdict != PASS:  # at a bound, a parameter has no covariance
                    print(f"  bag {k}: {outcome.verdict}: {outcome.reason[:300]}", flush=True)
                    continue
                off, covariance = parameter_error(outcome, arm(n, seed), dynamic)
                nees.append(float(off @ np.linalg.solve(covariance, off)) / len(off))
            print(
                f"{'dynamic' if dynamic else 'kinematic':9} {n} links  {count} good bags: "
                f"{passed} passed, {accused} with a cause, chi-square in its band in {band}, "
                f"NEES {np.mean(nees):.2f} +- {np.std(nees) / len(nees) ** 0.5:.2f}",
                flush=True,
            )


def check_early_causes():
    accused, total = 0, 0
    for count in (3, 5, 13):
        right = other = errors = 0
        for n in EARLY_SIZES:
            for seed in range(EARLY_SEEDS):
                q, tip, guess = observed(n, count, seed)
                accused += bool(cause_of(q, tip, guess))
                total += 1
                for words, make_error in ERRORS.items():
                    found = cause_of(*make_error(q, tip), guess)
                    right += found.startswith(words)
                    other += bool(found) and not found.startswith(words)
                    errors += 1
        print(
            f"{count:2} rests: {right} of {errors} errors named, {other} by another cause",
            flush=True,
        )
    print(f"{accused} of {total} good sets of rests with a cause")


if __name__ == "__main__":
    os.nice(5)
    if sys.argv[1:] == ["early"]:
        check_early_causes()
        sys.exit()
    if "good" not in sys.argv:
        check_faulty_bags()
    if "wrong" not in sys.argv:
        check_good_bags(int(sys.argv[-1]) if sys.argv[-1].isdigit() else 50)
