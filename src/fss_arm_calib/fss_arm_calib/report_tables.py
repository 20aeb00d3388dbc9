"""Tables shared by the reports of all kinds of calibration, and the default report."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS, format_count
from fss_arm_calib.dates import format_period, now
from fss_arm_calib.outcome import Estimate, Outcome
from fss_arm_calib.report import Figure, Report, Table
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import to_yaml
from fss_arm_model.planar import wrap


def make_report(
    title: str,
    outcome: Outcome[Any, Any],
    tables: Sequence[Table],
    details: Sequence[Table] = (),
    figures: Sequence[Figure] = (),
) -> Report:
    """Return the report of an outcome: tables of the kind, then those of all kinds."""
    o = outcome
    return Report(
        title=title,
        verdict=o.verdict,
        reason=o.summary,
        tables=tables,
        origin=format_origin(o),
        figures=() if o.solution is None else figures,
        details=(check_table(o), *(() if o.solution is None else details), stream_table(o)),
        below=[
            f"Data of {format_period(o.provenance.begin, o.provenance.end)}, "
            f"report of {now()} UTC.",
            *next_steps(o),
        ],
        texts={"Settings": o.provenance.parameters, "Initial description": to_yaml(o.arm)},
    )


def next_steps(outcome: Outcome[Any, Any]) -> tuple[str, ...]:
    """Return lines with the recommended next step; a command has lines of its own."""
    if outcome.verdict != PASS or not (uncertain := outcome.estimate.uncertain):
        return (NEXT_STEPS[outcome.verdict],)
    arm, names = outcome.settings.arm, " ".join(k for k in outcome.names if k in uncertain)
    return (
        f"Next: record maneuvers that determine {names}. To plan them:",
        f"  ros2 run fss_arm_calib design --bag BAG{f' --arm {arm}' if arm else ''} \\",
        f"    --chosen '{names}' --output plan.yaml",
    )


#: Recommended next step, by verdict.
NEXT_STEPS = {
    PASS: "Next: give the calibrated description (file of `output`) to the nodes; keep the bag.",
    FAIL: "Next: do not use these numbers. The checks (--details, or the report) show why.",
    NOT_EVALUATED: "Next: record the missing data; the data received count already.",
}


def table_report(outcome: Outcome[Any, Any], truth: Arm | None = None) -> Report:
    """Return the default report of a calibration: its parameters and its checks."""
    what = (
        format_count(len(outcome.used), "datum")
        if len(outcome.used) == 1
        else f"{len(outcome.used)} data"
    )
    return make_report(
        f"Calibration of {outcome.arm.name} from {what}", outcome, [parameter_table(outcome)]
    )


def parameter_table(
    outcome: Outcome[Any, Any],
    columns: Mapping[str, Floats] | None = None,
    ratios: Mapping[str, tuple[Floats, str]] | None = None,
    labels: Mapping[str, str] | None = None,
    note: str = "",
    weak: Sequence[int] = (),
) -> Table:
    """Return the table of the parameters.

    Args:
        outcome: the outcome with p parameters.
        columns: (p,) values in the parameters' units, by head; by default the initial guess, the
            estimate and its deviation.
        ratios: (p,) further numbers and their format, by head.
        labels: names to show in place of others.
        note: explanation.
        weak: indices of parameters shown in amber.
    """
    e, ratios, labels = outcome.estimate, ratios or {}, labels or {}
    columns = columns or {"guess": e.initial, "estimate": e.values, "± 1 sigma": e.deviations}
    rows = []
    for k, (name, unit) in enumerate(zip(e.names, e.units, strict=True)):
        row = [display_name(name, e, labels.get(name, "")), display_unit(unit)]
        row += [format_value(column[k], unit) for column in columns.values()]
        rows.append(row + [format_number(ratio[k], form) for ratio, form in ratios.values()])
    head = ["parameter", "unit", *columns, *ratios]
    return Table("Parameters", head, rows, words=2, note=note, weak=weak)


def relative_errors(estimate: Estimate, true: Floats) -> Floats:
    """Return the errors (p,) of an estimate in its deviations; NaN if not determined."""
    rows = zip(estimate.values, true, estimate.units, strict=True)
    off = np.array([difference(value, known, unit) for value, known, unit in rows])
    return off / mask_undetermined(estimate, estimate.deviations)


def format_origin(outcome: Outcome[Any, Any]) -> str:
    """Describe software, source and data hash of a result."""
    p = outcome.provenance
    return f"by {p.software} from {p.source}; SHA-256 of the data {p.data_hash}"


def check_table(outcome: Outcome[Any, Any]) -> Table:
    """Return the table of the checks that decide the verdict."""
    rows = [
        [
            c.name,
            c.verdict.replace("_", " "),
            c.reason,
            format_number(c.value, ".4g"),
            format_number(c.threshold, ".4g"),
        ]
        for c in outcome.checks
    ]
    head = ["check", "verdict", "reason", "value", "threshold"]
    note = (
        "chi-square of the fit: of the residuals in the given deviations, or in the largest "
        "accepted ones where the deviations are estimated."
    )
    return Table("Checks", head, rows, words=3, note=note)


def stream_table(outcome: Outcome[Any, Any]) -> Table:
    """Return the table of rejected samples, by stream and reason, and of the clocks' offset."""
    s = outcome.streams
    rows: list[Sequence[str]] = [[kind, str(number)] for kind, number in s.rejected.items()]
    if np.isfinite(s.offset.value):
        offset = f"{1e3 * s.offset.value:.2f} ± {1e3 * s.offset.deviation:.2f} ms"
        rows.append(["joints' stamps minus motion capture's", offset])
    rows = rows or [["nothing to report", ""]]
    return Table("Rejected samples and clocks", ["what", ""], rows)


def display_name(name: str, estimate: Estimate, words: str = "") -> str:
    """Return a parameter's name, or `words` for it, marked if it is at its bound."""
    return f"{words or name}{', at its bound' * (name in estimate.at_bound)}"


def display_unit(unit: str) -> str:
    """Return the unit that is shown: deg for rad, others unchanged."""
    return "deg" if unit == "rad" else unit


def format_value(value: float, unit: str) -> str:
    """Format a value in the unit that is shown."""
    if unit == "rad":
        return format_number(np.degrees(value), ".3f")
    return format_number(value, ".6f" if unit == "m/s^2" else ".4f")  # a table's tilt is small


def difference(value: float, true: float, unit: str) -> float:
    """Return value - true; angles are wrapped."""
    return float(wrap(value - true) if unit == "rad" else value - true)


def mask_undetermined(estimate: Estimate, numbers: Floats) -> Floats:
    """Return numbers (p,), with NaN for parameters that are not determined."""
    return np.where(np.isfinite(estimate.deviations), numbers, np.nan)


def format_number(value: float, form: str) -> str:
    """Format a number; `-` if it is not finite."""
    return f"{value:{form}}" if np.isfinite(value) else "-"
