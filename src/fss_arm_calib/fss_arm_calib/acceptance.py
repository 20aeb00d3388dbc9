"""When to believe a result: checks that calibrations of every kind share, and their verdict."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats, Mask
from fss_arm_calib.estimation.noise import Noise
from fss_arm_calib.estimation.statistics import probability
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm

PASS, FAIL, NOT_EVALUATED = "pass", "fail", "not_evaluated"

CAUSE = "cause"  # the check that says what probably went wrong
MOST_REASONS = 4  # of a verdict that is no pass; its checks tell the others

TOLERANCE = 1e-9  # of the last update [deviations]


@dataclass(frozen=True)
class Check:
    """One of the things that a calibration must meet to pass, as Check.msg has it."""

    name: str
    verdict: str
    value: float
    threshold: float
    reason: str  # with value and threshold, in words
    needed: bool = True  # to be evaluated; a check that fails always counts


def at_most(name: str, value: float, threshold: float, reason: str, failing: str = "") -> Check:
    """A check that passes if the value is not above the threshold; `failing` says what it means."""
    passed = value <= threshold  # NaN is not
    words = reason if passed or not failing else f"{failing}: {reason}"
    return Check(name, PASS if passed else FAIL, value, threshold, words)


def by_chance(
    name: str, chi_square: float, freedom: float, least: float, failing: str, known_by: float = inf
) -> Check:
    """A check that passes unless residuals as large as found are less probable than `least`.

    Args:
        name: of the check.
        chi_square: sum of their squares, in deviations.
        freedom: its degrees of freedom.
        least: probability.
        failing: what it means if they are larger.
        known_by: degrees of freedom by which the deviations were estimated; inf: they are known.
    """
    chance = probability(chi_square, freedom, known_by)
    facts = (
        f"chi-square {chi_square:.4g} for {freedom:.4g} degrees of freedom, "
        f"probability {chance:.2g} (at least {least:g})"
    )
    passed = chance >= least
    reason = facts if passed else f"{failing}: {facts}"
    return Check(name, PASS if passed else FAIL, chance, least, reason)


def fitting(chi_square: float, freedom: float, least: float, failing: str, noise: Noise) -> Check:
    """Whether residuals are as small as given, or as is believed of what they are estimated by."""
    check = by_chance("fit", chi_square, freedom, least, failing)
    if noise.given.all():
        return check
    return replace(check, reason=f"{check.reason}; errors are {noise} by the residuals")


def joints_known(streams: Streams, arm: Arm) -> Check:
    """Whether no joint was heard that the arm does not have."""
    unknown = streams.unknown
    reason = f"{', '.join(unknown)} heard, but {arm.name!r} has {count(arm.n, 'joint')}"
    verdict = NOT_EVALUATED if unknown else PASS
    return Check("joints", verdict, arm.n + len(unknown), arm.n, reason if unknown else "")


def clocks_kept(streams: Streams, most: float) -> Check:
    """Whether no clock ran back by more than `most` [s], which may have hidden what happened.

    Clocks too far apart to be aligned are only reported: swapped subjects look the same.
    """
    name, back = max(streams.set_back.items(), key=lambda item: item[1], default=("", 0.0))
    reason, bad = "", back > most
    if bad:
        reason = f"clock of {name} ran back by {back:.3g} s (at most {most:g})"
    elif streams.offset_beyond:
        reason = f"by most moves the clocks differ by more than {streams.offset_beyond:g} s"
        reason += ", or the subjects are swapped"
    verdict = NOT_EVALUATED if reason else PASS
    return Check("clocks", verdict, back, most, reason, needed=bad)


def suspected(streams: Streams) -> list[Check]:
    """What about the streams alone may be the cause of a verdict, each the likelier first."""
    words = [*streams.doubts]
    if streams.silent and streams.others:
        names, heard = ", ".join(streams.silent), ", ".join(streams.others)
        words.append(f"nothing heard of {names}, but of {heard}: other names?")
    if differ := frames_differ(streams):
        words.append(differ)
    return [cause(one) for one in words]


def frames_differ(streams: Streams) -> str:
    """In which frames subjects are seen, if not in one; else nothing."""
    if len(set(streams.frames.values())) < 2:
        return ""
    frames = " and ".join(f"{name} in {frame!r}" for name, frame in streams.frames.items())
    return f"poses in frames that differ: {frames}"


def enough(name: str, found: float, needed: float, reason: str, streams: Streams) -> Check:
    """Whether there are data enough for a verdict; if not, what the streams say of it."""
    if found >= needed:
        return Check(name, PASS, found, needed, reason)
    if streams.silent:
        reason += f"; nothing heard of {', '.join(streams.silent)}"
    if rejected := [f"{number} {why}" for why, number in streams.rejected.items() if number]:
        reason += f"; samples rejected: {', '.join(rejected)}"
    return Check(name, NOT_EVALUATED, found, needed, reason)


def determined(
    undetermined: Sequence[str], missing: int, condition: float, most: float, hint: str = ""
) -> Check:
    """Whether the data determine all parameters.

    Args:
        undetermined: names of those that they do not.
        missing: number of their combinations that are not determined.
        condition: number of the column-scaled regressor.
        most: that it may be.
        hint: at what it may lie.
    """
    facts = f"condition number {condition:.3g} (at most {most:g})"
    if not undetermined:
        return at_most("determined", condition, most, facts)
    reason = f"{', '.join(undetermined)} cannot be told apart: "
    reason += f"{count(missing, 'combination')} undetermined, {facts}{hint}"
    return Check("determined", NOT_EVALUATED, condition, most, reason)


def converged(well: bool, iterations: int, last_update: float, most: float = TOLERANCE) -> Check:
    """Whether the last update was negligible."""
    words = f"{count(iterations, 'iteration')}, last update {last_update:.2g} deviations"
    words = words if well else f"not converged: {words} (at most {most:g})"
    return Check("convergence", PASS if well else FAIL, last_update, most, words)


def outliers(errors: Floats, kept: Mask, limit: float, most: int, noun: str, what: str) -> Check:
    """Whether each datum kept agrees with the others.

    Args:
        errors: (s,) of each datum, in its deviations.
        kept: (s,) which were not rejected.
        limit: largest error.
        most: data that may be rejected.
        noun: what a datum is.
        what: the error is, in words.
    """
    worst = float(np.max(errors[kept]))
    words = f"largest {what} {worst:.3g} (at most {limit:g})"
    if rejected := np.flatnonzero(~kept).tolist():
        words += f", {numbers(rejected, noun)} rejected (at most {most})"
    far = [k for k in np.argsort(-errors).tolist() if kept[k] and errors[k] > limit]
    return at_most("outliers", worst, limit, words, f"{numbers(far, noun)} off" if far else "")


def checked(redundancy: Floats, kept: Mask, least: float, noun: str) -> Check:
    """Whether the others check each datum: of one that decides alone no error is seen.

    Args:
        redundancy: (k,) of those kept, as estimation.statistics has it.
        kept: (s,) which were not rejected.
        least: redundancy that is asked for.
        noun: what a datum is.
    """
    worst = int(np.argmin(redundancy))
    which, value = numbers([int(np.flatnonzero(kept)[worst])], noun), float(redundancy[worst])
    facts = f"redundancy {value:.2g} (at least {least:g})"
    if value >= least:
        return Check("redundancy", PASS, value, least, "")
    reason = f"{which} hardly checked by the others: {facts}"
    return Check("redundancy", NOT_EVALUATED, value, least, reason)


def cause(words: str, verdict: str = FAIL) -> Check:
    """What probably went wrong; never a reason of its own for a verdict."""
    return Check(CAUSE, verdict, nan, nan, words, needed=False)


def conclude(checks: Sequence[Check]) -> tuple[str, tuple[str, ...]]:
    """The verdict of all checks, and its reasons: the likely cause, what lacks, what failed.

    What lacks something that is needed is not evaluated: a failure may follow from that. Of a pass
    the reasons are what is well.
    """
    causes = [s for s in checks if s.name == CAUSE]
    missing = [s for s in checks if s.verdict == NOT_EVALUATED and s.needed and s not in causes]
    failed = [s for s in checks if s.verdict == FAIL and s not in causes]
    verdict = NOT_EVALUATED if missing else FAIL if failed else PASS
    if verdict == PASS:
        return verdict, tuple(s.reason for s in checks if s.reason and s not in causes)
    notes = [s for s in checks if s.verdict == NOT_EVALUATED and s not in [*missing, *causes]]
    reasons = [s.reason for s in [*causes, *missing, *failed, *notes] if s.reason]
    return verdict, tuple(dict.fromkeys(reasons))[:MOST_REASONS]


def quiet(check: Check) -> Check:
    """The check without words if it passes: nothing worth a reader's time."""
    return check if check.verdict != PASS else replace(check, reason="")


def count(number: int, what: str) -> str:
    """A number of things in words."""
    return f"{number} {what}{'s' * (number != 1)}"


def numbers(which: Sequence[int], noun: str = "observation") -> str:
    """Data counted from 1, in words."""
    return f"{noun}{'s' * (len(which) > 1)} {', '.join(str(k + 1) for k in which)}"
