"""Check the covariance of lengths and angles (python bench/bench_rests.py [DRAWS [KIND ...]]).

DRAWS (300) random arms of 4 links with 20 rests each, whose poses have unknown errors. KINDs of
errors: `isotropic`; mostly of the heading of the `base`, or of the `tip`; `split`, of both, where a
joint slips in half of the rests, so that two parts have the same error. Lengths and angles are
estimated from the rests alone, masses and inertias from 12 maneuvers with these lengths and angles,
and all jointly with 3 drifts.

Printed are the root mean square of each parameter's error divided by its deviation, and NEES, the
normalized squared error per parameter. Exits with 1 if one of the former is not between 0.9 and
1.1, or NEES not between 0.95 and 1.05, by more than 2.6 standard deviations of chance. Inertias
that come mostly from their prior are left out of the former: the prior is wider than the errors.
"""

import sys
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from calib_joint import ARM, SETTINGS, SURROUNDINGS, draw_arm, drifts, errors, maneuvers
from calib_rests import observe, seen_tips

from fss_arm_calib.joint.calibrate import Session, calibrate
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES, KINDS
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_calib.segments.rests import RestFinder
from fss_arm_model.description_file import from_yaml
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.parameters import parameter_names
from fss_arm_model.units import SECOND
from fss_arm_ros.calibrated import with_kinematics_of

REST_COUNT = 20
#: Errors of relative positions [m], and of both headings [rad]: the end effector's, the base's.
NOISE = {
    "isotropic": (0.001, radians(0.1), 0.0),
    "base": (0.0005, radians(0.1), radians(0.4)),
    "tip": (0.0005, radians(0.4), radians(0.02)),
    "split": (0.0005, radians(0.1), radians(0.1)),
}
RESTS = KinematicSettings(parametrization="full")
JOINT = JointSettings()

REST, MOVE, SLIP_TIME = 5.0, 2.0, 1.8  # of a posture in a stream [s]
SLIP = 0.002  # of the first joint, twice the motion threshold [rad]
RATE, JOINT_RATE = 50, 10  # of poses and readings [Hz]


def find_split_rests(arm, q, noise, rng):
    """Return the observations of a stream in which every second rest has a slip."""
    period, steps = REST + MOVE, np.diff(q, axis=0, append=q[-1:])

    def readings(t):
        k = (t // period).astype(int)
        since = t - k * period
        x = np.clip((since - REST) / MOVE, 0.0, 1.0)[:, None]
        found = q[k] + steps[k] * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        found[:, 0] += SLIP * ((k % 2 == 0) & (since > SLIP_TIME))
        return found

    t = np.arange(0.0, len(q) * period - MOVE, 1.0 / RATE)
    k = ((t + MOVE / 2) // period).astype(int)
    tip = tip_in_base(arm.vector(), readings(t))
    # An error of the base turns what is seen from it; so the base may stay where it is.
    lasting = noise * rng.standard_normal((len(q), 3))
    across = noise[0] * rng.standard_normal(len(q))
    tip[:, :2] += np.column_stack([lasting[:, 0], across])[k]
    tip[:, 2] += lasting[k, 1]
    base = np.column_stack([np.zeros((len(t), 2)), lasting[k, 2]])
    fresh = np.array([2e-4, 2e-4, 5e-4])
    seen = {name: poses + fresh * rng.standard_normal(poses.shape)
            for name, poses in ((BASE, base), (TIP, tip))}  # fmt: skip
    finder, found = RestFinder(arm.n, RESTS), []
    stamps, read = (t * SECOND).astype(np.int64), t[:: RATE // JOINT_RATE]
    for at, reading in zip((read * SECOND).astype(int).tolist(), readings(read), strict=True):
        for i, one in enumerate(reading.tolist(), 1):
            found += finder.add_reading(i, at, one)
        now = (stamps >= at) & (stamps < at + SECOND // JOINT_RATE)
        for name, poses in seen.items():
            found += finder.add_poses(name, stamps[now], poses[now])
    return found + finder.close()


def draw(seed, kind):
    """Return a true arm, and its rests, maneuvers and drifts."""
    rng = np.random.default_rng([29, seed])
    truth, acting = draw_arm(rng), SURROUNDINGS * rng.standard_normal(5)
    q = rng.uniform(-1.4, 1.4, (REST_COUNT, truth.n))
    if kind == "split":
        rests = find_split_rests(truth, q, np.array(NOISE[kind]), rng)
    else:
        (tips,) = seen_tips(tip_in_base(truth.vector(), q), NOISE[kind], rng)
        exact = observe(q, arm=truth, sigma=np.zeros(3))
        rests = [replace(o, tip=tuple(tip)) for o, tip in zip(exact, tips.tolist(), strict=True)]
    return truth, rests, maneuvers(truth, 12, rng, acting), drifts(truth, 3, rng, acting)


def score(estimate, truth):
    """Return the errors of the arm's parameters in deviations, and their normalized squared sum."""
    known = [k for k, name in enumerate(estimate.names) if name in parameter_names(truth.n)]
    names, C = [estimate.names[k] for k in known], estimate.covariance[np.ix_(known, known)]
    error, measured = errors(names, estimate.values[known], truth), np.isfinite(estimate.deviations)
    ratios = np.where(measured[known], error / np.sqrt(np.diag(C)), np.nan)
    return [*ratios, error @ np.linalg.solve(C, error) / len(error)]


def check(name, outcome_names, scores, passed):
    """Print the scores of all draws; return True if they are as good as they should be."""
    scores = np.array(scores)
    ratios, nees = np.sqrt(np.nanmean(scores[:, :-1] ** 2, axis=0)), np.mean(scores[:, -1])
    draws, seen = len(scores), np.count_nonzero(np.isfinite(scores[:, :-1]), axis=0)
    chance = 2.6 / np.sqrt(2 * seen)
    by_name = " ".join(f"{one} {x:.2f}" for one, x in zip(outcome_names, ratios, strict=True))
    print(f"{name}: NEES {nees:.3f}, {passed} of {draws} passed\n    {by_name}", flush=True)
    spread = 2.6 * np.std(scores[:, -1]) / np.sqrt(draws)
    return abs(nees - 1.0) < 0.05 + spread and np.all(np.abs(ratios - 1.0) < 0.1 + chance)


def main(draws, kinds):
    good = True
    of_kinds = {**SETTINGS, "kinematic": RESTS}
    for kind in kinds:
        outcomes = {"kinematic": [], "dynamic": [], "joint": []}
        for seed in range(draws):
            truth, rests, moves, drifting = draw(seed, kind)
            found = {"kinematic": KINDS["kinematic"].calibrate(rests, ARM, RESTS)}
            if lengths := found["kinematic"].description:
                arm = with_kinematics_of(from_yaml(lengths), ARM)
                found["dynamic"] = KINDS["dynamic"].calibrate(moves, arm, SETTINGS["dynamic"])
            session = Session("", {"kinematic": rests, "dynamic": moves, "drift": drifting})
            found["joint"] = calibrate([session], ARM, JOINT, JOINT_SOURCES, of_kinds)
            for name, one in found.items():
                outcomes[name].append((one, score(one.estimate, truth)))
        for name, several in outcomes.items():
            passed = sum(one.verdict == "pass" for one, _ in several)
            names = [one for one in several[0][0].names if one in parameter_names(ARM.n)]
            good &= check(f"{kind}, {name}", names, [each for _, each in several], passed)
    return 0 if good else 1


if __name__ == "__main__":
    given = sys.argv[1:]
    sys.exit(main(int(given[0]) if given else 300, given[1:] or [*NOISE]))
