"""Checks that several kinds of calibration share: each compares a value with a threshold."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan

import numpy as np

from fss_arm_calib.acceptance import (
    CAUSE,
    FAIL,
    FIT,
    NOT_EVALUATED,
    PASS,
    Check,
    format_count,
    format_indices,
)
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import MAX_CONDITION, Fit, Mask, Minimum
from fss_arm_model.estimation.noise import Noise
from fss_arm_model.estimation.statistics import probability

UPDATE_TOLERANCE = 1e-9  # largest last update of a converged solution [deviations]


def limit(name: str, value: float, threshold: float, reason: str, failure_text: str = "") -> Check:
    """Return a check that passes if value <= threshold; `failure_text` explains a failure."""
    if value <= threshold:  # False for NaN
        return Check(name, PASS, value, threshold, reason)
    words = f"{failure_text}: {reason}" if failure_text else reason
    return Check(name, FAIL, value, threshold, words, brief=failure_text)


def chi_square(
    name: str,
    squares: float,
    freedom: float,
    min_probability: float,
    failure_text: str,
    deviation_freedom: float = inf,
) -> Check:
    """Return a check that fails if residuals this large are less probable than `min_probability`.

    `squares` is the sum of the squared residuals in standard deviations. These deviations are
    known, or estimated with `deviation_freedom` degrees of freedom.
    """
    chance = probability(squares, freedom, deviation_freedom)
    size = f"{squares:.4g} for {freedom:.4g} degrees of freedom"
    facts = f"chi-square {size}, probability {chance:.2g} (at least {min_probability:g})"
    if chance >= min_probability:
        brief = f"chi-square of the fit {size}" if name == FIT else ""
        return Check(name, PASS, chance, min_probability, facts, brief=brief)
    words = f"{failure_text}: {facts}"
    return Check(name, FAIL, chance, min_probability, words, brief=failure_text)


def fit(
    squares: float, freedom: float, min_probability: float, failure_text: str, noise: Noise
) -> Check:
    """Check that the residuals agree with the given or estimated deviations."""
    check = chi_square(FIT, squares, freedom, min_probability, failure_text)
    if noise.is_given.all():
        return check
    words = f"{check.reason}; deviations estimated from the residuals: {noise}"
    return replace(check, reason=words)


def joint_names(streams: Streams, arm: Arm) -> Check:
    """Check that no readings were received of a joint that the arm does not have."""
    count = arm.n + len(streams.unknown)
    if not streams.unknown:
        return Check("joints", PASS, count, arm.n, "")
    names, known = ", ".join(streams.unknown), format_count(arm.n, "joint")
    reason = f"received {names}, but {arm.name!r} has {known}"
    reason += "; give the description of the arm in use"
    return Check("joints", NOT_EVALUATED, count, arm.n, reason)


def clocks(streams: Streams, max_jump: float) -> Check:
    """Check that no clock jumped back by more than `max_jump` [s], which may have hidden data.

    Clocks that are too far apart to be aligned are only reported: swapped subjects look the same.
    """
    name, jump = max(streams.set_back.items(), key=lambda item: item[1], default=("", 0.0))
    reason, bad = "", jump > max_jump
    if bad:
        reason = f"clock of {name} jumped back by {jump:.3g} s (at most {max_jump:g})"
    elif streams.offset_lower_bound:
        reason = (
            "most moves indicate that the clocks differ by more than "
            f"{streams.offset_lower_bound:g} s, or the subjects are swapped"
        )
    verdict = NOT_EVALUATED if reason else PASS
    return Check("clocks", verdict, jump, max_jump, reason, needed=bad)


def data_amount(
    name: str, found: float, needed: float, reason: str, streams: Streams, brief: str = ""
) -> Check:
    """Check that the data suffice for a verdict; if not, list silent streams and rejections."""
    if found >= needed:
        return Check(name, PASS, found, needed, reason, brief=brief)
    if streams.silent:
        reason += f"; nothing received from {', '.join(streams.silent)}"
    if rejected := [f"{number} {why}" for why, number in streams.rejected.items() if number]:
        reason += f"; samples rejected: {', '.join(rejected)}"
    return Check(name, NOT_EVALUATED, found, needed, reason)


def identifiability(
    r: Fit, hint: str = "", max_condition: float = MAX_CONDITION, hide_reason: bool = True
) -> Check:
    """Check that the data determine all parameters of a result; `hint` is a cause or a remedy.

    The condition number is that of the column-scaled regressor. If the check passes, it has a
    reason only without `hide_reason`.
    """
    facts = f"condition number {r.condition_number:.3g} (at most {max_condition:g})"
    if not r.undetermined:
        check = limit("determined", r.condition_number, max_condition, facts)
        return hide_pass_reason(check) if hide_reason else check
    reason = f"{', '.join(r.undetermined)} cannot be determined separately: "
    reason += f"{format_count(r.missing, 'combination')} undetermined, {facts}{hint}"
    return Check("determined", NOT_EVALUATED, r.condition_number, max_condition, reason)


def bounds(at_bound: Sequence[str], advice: str) -> Check:
    """Check that no parameter is at a bound of what is physically possible."""
    if not at_bound:
        return Check("bounds", PASS, 0, 0, "")
    brief = f"at a physical bound: {', '.join(at_bound)}"
    words = f"{brief}: another arm's data, or wrong masses or lengths?{advice}"
    return Check("bounds", FAIL, len(at_bound), 0, words, brief=brief)


def convergence(m: Minimum, tolerance: float = UPDATE_TOLERANCE) -> Check:
    """Check that the last update of a minimum was negligible."""
    number = format_count(m.iterations, "iteration")
    words = f"{number}, last update {m.last_update:.2g} deviations"
    words = words if m.converged else f"not converged: {words} (at most {tolerance:g})"
    return Check("convergence", PASS if m.converged else FAIL, m.last_update, tolerance, words)


def outliers(
    errors: Floats, kept: Mask, max_error: float, max_outliers: int, noun: str, error_name: str
) -> Check:
    """Check that the errors of the data `kept` are small; (s,) each, errors in deviations."""
    largest = float(np.max(errors[kept]))
    words = f"largest {error_name} {largest:.3g} (at most {max_error:g})"
    if rejected := np.flatnonzero(~kept).tolist():
        words += f", {format_indices(rejected, noun)} rejected (at most {max_outliers})"
    outliers = [k for k in np.argsort(-errors).tolist() if kept[k] and errors[k] > max_error]
    failure_text = f"{format_indices(outliers, noun)} inconsistent" if outliers else ""
    return limit("outliers", largest, max_error, words, failure_text)


def redundancy(shares: Floats, kept: Mask, min_redundancy: float, noun: str) -> Check:
    """Check that each datum kept (s,) is verified by the others, so that an error would show.

    `shares` (kept,) are those of `statistics.redundancy`.
    """
    worst = int(np.argmin(shares))
    value = float(shares[worst])
    if value >= min_redundancy:
        return Check("redundancy", PASS, value, min_redundancy, "")
    which = format_indices([int(np.flatnonzero(kept)[worst])], noun)
    facts = f"redundancy {value:.2g} (at least {min_redundancy:g})"
    reason = f"{which} poorly verified by the others: {facts}"
    return Check("redundancy", NOT_EVALUATED, value, min_redundancy, reason)


def cause(words: str, verdict: str = FAIL) -> Check:
    """Return a check that gives a probable cause; it never decides the verdict."""
    return Check(CAUSE, verdict, nan, nan, words, needed=False)


def stream_causes(streams: Streams) -> list[Check]:
    """Return possible causes of a verdict in the streams themselves, the most likely one first."""
    words = [*streams.problems]
    if streams.silent and streams.other_names:
        silent, received = ", ".join(streams.silent), ", ".join(streams.other_names)
        words.append(f"nothing received from {silent}, but from {received}: wrong names?")
    if differ := frame_mismatch(streams):
        words.append(differ)
    return [cause(one) for one in words]


def frame_mismatch(streams: Streams) -> str:
    """Describe the frames of the subjects' poses if they differ; empty if they do not."""
    if len(set(streams.frames.values())) < 2:
        return ""
    frames = " and ".join(f"{name} in {frame!r}" for name, frame in streams.frames.items())
    return f"poses are in different frames: {frames}"


def hide_pass_reason(check: Check) -> Check:
    """Return the check, without its reason if it passes, to keep the report short."""
    return check if check.verdict != PASS else replace(check, reason="")
