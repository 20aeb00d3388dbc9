"""Search for the cause of a failed calibration: typical laboratory errors, tested one by one.

Each hypothesis changes the recorded data or the settings, and the calibration is repeated from the
start. A hypothesis with which the calibration passes is reported but never applied: the verdict
does not change. If several pass, the one whose result is nearest to the description is reported,
because an arm also fits its mirror image; of several near enough, that with the least residuals.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import inf, radians
from time import process_time
from typing import Any

import numpy as np

from fss_arm_bags.doctor.clock_lag import estimate_lag
from fss_arm_bags.doctor.reading_faults import (
    find_reading_errors,
    sample_readings,
    tip_in_world,
    unwrap_readings,
)
from fss_arm_bags.doctor.stream_faults import find_faults, name_streams
from fss_arm_bags.recorded import Recorded, Track
from fss_arm_calib.acceptance import CAUSE, PASS
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.checks import cause
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import difference
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_calib.segments.replay import replay
from fss_arm_calib.segments.samples import MAX_VALUE
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, joint_names
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.units import SECOND
from fss_arm_ros.dates import describe_clock_error

MAX_LENGTH = 900.0  # length of the last part of the recording that is used [s]
JOINT_PERIOD, POSE_PERIOD = 0.05, 0.02  # sample periods to which the data are thinned [s]
#: Checks that can fail although the data agree with the model.
PRECISION_CHECKS = {"precision", "redundancy"}

MAX_SEARCH_TIME = 60.0  # limit of the processor time of the search [s]

MAX_POSITION = 8.0  # positions above this are not in meters: no test bed is that large [m]
MAX_READING = 3.3  # readings above this are probably not in radians [rad]
#: Largest expected errors of a description, by unit.
MAX_ERRORS = {"m": 0.05, "rad": radians(20.0)}
MAX_JOINT_ERRORS = 4  # orders and signs of joints that are tried, of those that fit the tip best
MIN_CLOCK_OFFSET = 0.25  # clock differences below this are ignored [s]
MAX_TILT = 0.01  # mean x^2 + y^2 of a quaternion above which the subject is not flat


@dataclass(frozen=True)
class Hypothesis:
    """Possible error, with the recording and settings that would correct it."""

    words: str  # the error, as a question
    remedy: str  # the correction, in words
    recorded: Recorded
    settings: Any
    stage: int = 0  # place of its maker: errors of one maker resemble each other


#: Errors that a maker tests: the error, its remedy, and the corrected recording or settings.
Errors = Iterator[tuple[str, str, Recorded | dict[str, Any]]]
Maker = Callable[[Recorded, Arm, Any], Errors]
JointError = tuple[str, str, Recorded]


def explain_failure(
    kind: Calibration[Any, Any], outcome: Outcome[Any, Any], recorded: Recorded
) -> Outcome[Any, Any]:
    """Return the outcome with the likely cause of its verdict, if one is found.

    There is no search for data that agree with the model but are insufficient, or without streams.
    """
    failing = {check.name for check in outcome.checks if check.needed and check.verdict != PASS}
    if outcome.verdict == PASS or failing - {CAUSE} <= PRECISION_CHECKS or not recorded.tracks:
        return outcome
    faults = "; ".join(find_faults(recorded))
    faults = other_arm(outcome.arm, recorded) or faults
    words = faults or find_cause(kind, outcome.arm, outcome.settings, recorded)
    if not words:
        return outcome
    others = [check for check in outcome.checks if check.name != CAUSE]
    return replace(outcome, checks=(cause(words, outcome.verdict), *others))


def other_arm(arm: Arm, recorded: Recorded) -> str:
    """Describe the difference if the recorded joints are all those of another arm; else empty."""
    n = len(recorded.joints)
    if n == arm.n or recorded.joints.keys() != set(joint_names(n)):
        return ""
    return (
        f"the data have {n} joints, description {arm.name!r} has {arm.n}: give the arm's "
        "description (--arm FILE)"
    )


def find_cause(kind: Calibration[Any, Any], arm: Arm, settings: Any, recorded: Recorded) -> str:
    """Describe the hypothesis that makes the calibration pass; empty if none does."""
    recorded = recorded.shorten(MAX_LENGTH, JOINT_PERIOD, POSE_PERIOD)
    until = process_time() + MAX_SEARCH_TIME
    best, smallest, stage = "", (inf, inf), 0
    as_it_is = calibrate_under(kind, arm, Hypothesis("", "", recorded, settings))
    if as_it_is and as_it_is.verdict == PASS:
        return ""  # the cause is not in the recorded streams
    lacking = as_it_is is None or as_it_is.solution is None
    for one in hypotheses(recorded, arm, settings, lacking):
        is_near = smallest[0] <= 1.0
        if process_time() > until or (is_near and one.stage > stage):
            break
        outcome = calibrate_under(kind, arm, one)
        if outcome is None or outcome.verdict != PASS:
            continue
        residual = 1e3 * outcome.estimate.position_residual
        size = max(description_error(outcome), 1.0), residual
        if size < smallest:
            smallest, stage = size, one.stage
            best = f"{one.words} {one.remedy}, the residuals are {residual:.2g} mm"
    return best


def calibrate_under(
    kind: Calibration[Any, Any], arm: Arm, one: Hypothesis
) -> Outcome[Any, Any] | None:
    """Calibrate under a hypothesis; None if that is impossible."""
    try:
        finder: Any = kind.finder(arm, one.settings, [])
        found = replay(one.recorded, finder)
        return kind.calibrate(found, arm, one.settings, finder.streams(), "")
    except (ArithmeticError, LookupError, ValueError):
        return None


def description_error(outcome: Outcome[Any, Any]) -> float:
    """Return the largest distance of the estimates from the description, over MAX_ERRORS."""
    e = outcome.estimate
    each = zip(e.names, e.values, e.initial, e.units, strict=True)
    known = (one for name, *one in each if one[2] in MAX_ERRORS and name != "theta_E")
    return max((abs(difference(*one)) / MAX_ERRORS[one[2]] for one in known), default=0.0)


def hypotheses(recorded: Recorded, arm: Arm, settings: Any, lacking: bool) -> Iterator[Hypothesis]:
    """Yield all hypotheses, the most easily recognized errors first."""
    for stage, maker in enumerate([*MAKERS, *FEW_DATA_MAKERS * lacking]):
        for words, remedy, change in maker(recorded, arm, settings):
            if isinstance(change, Recorded):
                yield Hypothesis(words, remedy, change, settings, stage)
            else:
                yield Hypothesis(words, remedy, recorded, replace(settings, **change), stage)


def _name_errors(recorded: Recorded, arm: Arm, _: Any) -> Errors:
    wanted = joint_names(arm.n)
    heard = sorted(recorded.joints, key=_last_number)
    if len(heard) == arm.n and heard != wanted:
        named = ", ".join(heard)
        tracks = {name: recorded.joints[own] for name, own in zip(wanted, heard, strict=True)}
        yield f"joints named {named}?", "in this order", replace(recorded, joints=tracks)


def _last_number(name: str) -> tuple[int, str]:
    digits = "".join(c if c.isdigit() else " " for c in name).split()
    return int(digits[-1][:9]) if digits else 0, name


def _unit_errors(recorded: Recorded, arm: Arm, _: Any) -> Errors:
    largest = {n: _typical_size(track.values[:, :3]) for n, track in recorded.poses.items()}
    far = [name for name, size in largest.items() if size > MAX_POSITION]
    if far:
        whose = "" if len(far) == len(largest) else f" of {', '.join(far)}"
        for unit, factor in (("millimeters", 1e-3), ("centimeters", 1e-2)):
            scale = _scaling(far, np.array([factor] * 3 + [1.0] * 4))
            words = f"position{whose} in {unit}?"
            yield words, f"with a factor of {factor:g}", recorded.change(poses=scale)
    wide = {n: _typical_size(track.values[:, :1]) for n, track in recorded.joints.items()}
    turned = [name for name, size in wide.items() if size > MAX_READING]
    if turned:
        whose = "joints" if len(turned) == len(wide) else ", ".join(turned)
        readings = np.concatenate([recorded.joints[name].values[:, 0] for name in turned])
        whole = bool(np.all(readings == np.round(readings)))
        remedy = "converted to radians"
        if not whole:
            changed = recorded.change(joints=_scaling(turned, radians(1.0)))
            yield f"{whose} in degrees?", remedy, changed
        if whole or max(wide.values()) > MAX_VALUE:
            changed = recorded
            for i, drive in enumerate((link.drive for link in arm.links), 1):
                radian = 2.0 * np.pi * drive.direction / drive.counts_per_turn
                here = [name for name in turned if name == f"joint_{i}"]
                changed = changed.change(joints=_scaling(here, radian))
            yield f"{whose} in counts?", remedy, changed


def _typical_size(values: Floats) -> float:
    seen = np.abs(values[np.isfinite(values)])
    return float(np.percentile(seen, 95)) if seen.size else 0.0


def _scaling(names: Sequence[str], by: Floats | float) -> Callable[[str, Track], Track]:
    """Return a change that scales the values of the named streams."""
    return lambda n, track: track._replace(values=track.values * by) if n in names else track


def _clock_errors(recorded: Recorded, arm: Arm, _: Any) -> Errors:
    """Yield clock errors, found from the times of receipt and of the motions."""
    late = {
        name: float(np.median(track.receipt - track.t)) / SECOND
        for name, track in [*recorded.joints.items(), *recorded.poses.items()]
        if len(track.t)
    }
    if not late:
        return
    right = min(late.values(), key=abs)
    off = {name: by - right for name, by in late.items() if abs(by - right) > MIN_CLOCK_OFFSET}
    if off:

        def restamp(_: str, track: Track) -> Track:
            return track.stamped_by_receipt()

        changed = recorded.change(joints=restamp, poses=restamp, rates=restamp)
        by = -float(np.median(list(off.values())))
        words = f"clock of {name_streams([*off], recorded)} {describe_clock_error(by)} the others?"
        yield words, "with the times of receipt", changed
    by = estimate_lag(recorded, BASE, TIP, 2.0 * MAX_LENGTH)
    if abs(by) > MIN_CLOCK_OFFSET:
        words = f"clock of the joints {describe_clock_error(by)} the subjects'?"
        earlier = round(by * SECOND)

        def shift(_: str, track: Track) -> Track:
            return track._replace(t=track.t - earlier)

        yield words, "with shifted stamps", recorded.change(joints=shift, rates=shift)


def _pose_errors(recorded: Recorded, arm: Arm, _: Any) -> Errors:
    values = [track.values for track in recorded.poses.values()]
    flat = all(np.nanmean(v[:, 3] ** 2 + v[:, 4] ** 2) < MAX_TILT for v in values if len(v))
    if BASE in recorded.poses and TIP in recorded.poses:
        swapped = {**recorded.poses, BASE: recorded.poses[TIP], TIP: recorded.poses[BASE]}
        changed = replace(recorded, poses=swapped)
        yield "base and end effector are swapped?", "swapped back", changed
    for words, remedy, columns, signs in (() if flat else TILTED_FRAMES) + REVERSED_AXES:
        turn = partial(_rearrange_columns, columns=columns, signs=signs)
        yield words, remedy, recorded.change(poses=turn)
    if len(values) > 1:
        words = "end effector already relative to the base?"
        yield words, "transformed to the world frame", tip_in_world(recorded, BASE, TIP)


# Error, remedy, and for each column of a pose (x y z, quaternion x y z w) its source and sign.
AS_RECORDED = [0, 1, 2, 3, 4, 5, 6]
TILTED_FRAMES = (
    ("quaternions with w first?", "reordered to x, y, z, w", [0, 1, 2, 4, 5, 6, 3], [1] * 7),
    ("poses with y up?", "rotated to z up", [0, 2, 1, 3, 5, 4, 6], [1, -1, 1, 1, -1, 1, 1]),
    ("poses with x up?", "rotated to z up", [1, 2, 0, 4, 5, 3, 6], [1] * 7),
)
REVERSED_AXES = (
    ("poses mirrored?", "with y and headings reversed", AS_RECORDED, [1, -1, 1, -1, 1, -1, 1]),
    ("headings clockwise?", "reversed", AS_RECORDED, [1, 1, 1, 1, 1, -1, 1]),
    ("positions mirrored?", "with y reversed", AS_RECORDED, [1, -1, 1, 1, 1, 1, 1]),
)


def _rearrange_columns(_: str, track: Track, columns: list[int], signs: list[int]) -> Track:
    return track._replace(values=track.values[:, columns] * signs)


def _joint_errors(recorded: Recorded, arm: Arm, _: Any) -> Errors:
    names = [name for name in joint_names(arm.n) if name in recorded.joints]
    jumps = [n for n in names if (np.abs(np.diff(recorded.joints[n].values[:, 0])) > np.pi).any()]
    if jumps:
        changed = recorded.change(joints=lambda n, t: unwrap_readings(t) if n in jumps else t)
        yield f"{', '.join(jumps)} wrapped?", "unwrapped", changed
    found = _orders_and_signs(recorded, names)
    yield from sorted(found, key=lambda one: _tip_error(one[2], arm))[:MAX_JOINT_ERRORS]


def _orders_and_signs(recorded: Recorded, names: Sequence[str]) -> Iterator[JointError]:
    if len(names) > 2:
        tracks = dict(zip(names, (recorded.joints[n] for n in reversed(names)), strict=True))
        yield "joints counted from the tip?", "in reverse order", replace(recorded, joints=tracks)
    for which in ([names] if len(names) > 1 else []) + [[name] for name in names]:
        who = which[0] if len(which) == 1 else "all joints"
        changed = recorded.change(joints=_scaling(which, -1.0))
        yield f"{who} with the wrong sign?", "reversed", changed
    for a, b in combinations(names, 2):
        tracks = {**recorded.joints, a: recorded.joints[b], b: recorded.joints[a]}
        yield f"{a} and {b} swapped?", "swapped back", replace(recorded, joints=tracks)


def _tip_error(recorded: Recorded, arm: Arm) -> float:
    """Return the median distance of the end effector from its description [m]; 0: unknown."""
    r = sample_readings(recorded, joint_names(arm.n), BASE, TIP)
    away = np.zeros((1, 2)) if r is None else tip_in_base(arm.vector(), r.q)[:, :2] - r.tip
    return float(np.nanmedian(np.hypot(*away.T)))


def _reading_errors(recorded: Recorded, arm: Arm, _: Any) -> Errors:
    for words, corrected in find_reading_errors(recorded, joint_names(arm.n), BASE, TIP):
        yield words, "corrected by the headings", corrected


def _setting_errors(recorded: Recorded, arm: Arm, s: Any) -> Errors:
    """Yield settings that these data cannot meet."""
    steps = (np.diff(track.t) for track in recorded.joints.values() if len(track.t) > 2)
    slow = max((float(np.median(step)) / SECOND for step in steps), default=0.0)
    if 2.0 * slow > s.joint_gap:
        gap = 3.0 * slow
        words = f"joints sampled only every {slow:.2g} s, but joint_gap is {s.joint_gap:g} s?"
        yield words, f"with --joint-gap {gap:.2g}", {"joint_gap": gap}
    for times in (5.0, 25.0):
        threshold = times * s.motion_threshold
        words = f"joints never at rest within {s.motion_threshold:g} rad?"
        remedy = f"with --motion-threshold {threshold:g}"
        yield words, remedy, {"motion_threshold": threshold}
    short = {"settle_time": 0.2, "min_duration": 0.2}
    yield "rests too short?", "with --settle-time 0.2 --min-duration 0.2", short


def _model_errors(recorded: Recorded, arm: Arm, s: Any) -> Errors:
    if getattr(s, "parametrization", "full") != "full":
        words = f"links of different lengths, but parametrization is {s.parametrization}?"
        yield words, "with --parametrization full", {"parametrization": "full"}
    if getattr(s, "theta_e", True) is False:
        words = "end effector's subject rotated against the last link?"
        yield words, "with --theta-e", {"theta_e": True}


MAKERS: list[Maker] = [_name_errors, _unit_errors, _model_errors]
MAKERS += [_clock_errors, _pose_errors, _reading_errors, _joint_errors]
FEW_DATA_MAKERS: list[Maker] = [_setting_errors]  # used only if there are too few data
