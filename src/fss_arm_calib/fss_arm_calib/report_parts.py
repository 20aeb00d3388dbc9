"""Tables and drawings shared by the reports of all kinds of calibration, and the default report."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.outcome import Estimate, Outcome
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import to_yaml
from fss_arm_model.parameters import describe_symbols
from fss_arm_model.planar import wrap
from fss_arm_ros import palette
from fss_arm_ros.dates import format_period, now
from fss_arm_ros.report import Figure, Report, Table


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
            *filter(None, [describe_symbols(o.names)]),
            f"Data of {format_period(o.provenance.begin, o.provenance.end)}; reported {now()} UTC.",
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
        "  ros2 run fss_arm_calib design --bag BAG \\",
        *([f"    --arm {arm} \\"] if arm else ()),
        f"    --chosen '{names}' --output plan.yaml",
    )


#: Recommended next step, by verdict.
NEXT_STEPS = {
    PASS: "Next: keep the bag; write the description (from_bag --output FILE), use it as `arm`.",
    FAIL: "Next: do not use these numbers. The checks (--details, or the report) show why.",
    NOT_EVALUATED: "Next: record the missing data; the data received count already.",
}


def with_description(report: Report, path: object) -> Report:
    """Return a report whose next step names the file of the calibrated description."""
    named = f"Next: keep the bag; give the nodes -p arm:={path}."
    return replace(report, below=[named if x == NEXT_STEPS[PASS] else x for x in report.below])


#: Units of value and threshold of a check, by its name; those of other checks have none.
CHECK_UNITS = {
    "clocks": "s",
    "time": "s",
    "lengths": "m",
    "description": "m",
    "end_effector": "m",
    "tilt": "rad",
    "torque": "N m",
}


def table_report(outcome: Outcome[Any, Any], truth: Arm | None = None) -> Report:
    """Return the default report of a calibration: its parameters and its checks."""
    what = f"{len(outcome.used)} {'datum' if len(outcome.used) == 1 else 'data'}"
    title = f"Calibration of {outcome.arm.name} from {what}"
    return make_report(title, outcome, [parameter_table(outcome)])


def parameter_table(
    outcome: Outcome[Any, Any],
    columns: Mapping[str, Floats] | None = None,
    ratios: Mapping[str, tuple[Floats, str]] | None = None,
    labels: Mapping[str, str] | None = None,
    note: str = "",
    weak: Sequence[int] = (),
) -> Table:
    """Return the table of the p parameters.

    `columns` are values (p,) in the parameters' units, by head: by default the initial guess, the
    estimate and its deviation. `ratios` are further numbers (p,) and their format, by head.
    `labels` are shown in place of names. `weak` parameters are shown in amber.
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


def residual_table(subject: str, columns: Mapping[str, Sequence[float]], note: str = "") -> Table:
    """Return the table of the residuals' standard deviations, of a subject's poses.

    `columns` are those of positions [m] and headings [rad], by head.
    """
    rows = [
        [name, display_unit(unit), *(format_value(pair[k], unit) for pair in columns.values())]
        for k, (name, unit) in enumerate((("position", "m"), ("heading", "rad")))
    ]
    head = [subject, "unit", *columns]
    return Table("Standard deviation of the residuals", head, rows, words=2, note=note)


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
    rows = []
    for c in outcome.checks:
        numbers = [format_number(x, ".4g") for x in (c.value, c.threshold)]
        unit = CHECK_UNITS.get(c.name, "")
        rows.append([c.name, c.verdict.replace("_", " "), c.reason, *numbers, unit])
    head = ["check", "verdict", "reason", "value", "threshold", "unit"]
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
    """Return a parameter's name, or `words` for it, with the reason if it is not determined."""
    if name in estimate.at_bound:
        return f"{words or name}, at its bound"
    return f"{words or name}{', not determined' * (name in estimate.unmeasured)}"


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


def common_figures(
    outcome: Outcome[Any, Any], kind: str, noun: str, label: str, names: Sequence[str] = ()
) -> tuple[Figure, Figure]:
    """Return the figures of all kinds: the influence of each datum, and the correlation matrix.

    A datum is a `noun`, with an error `label`. The parameters are shown by `names`, or their own.
    """
    o, names = outcome, names or outcome.names
    influence = Figure(f"{kind}_{noun}s", f"Each {noun}", lambda: draw_influence(o, label))
    title, draw = "Correlation of the parameters", partial(draw_correlation, o.covariance, names)
    return influence, Figure(f"{kind}_correlation", title, draw)


def draw_correlation(covariance: Floats, labels: Sequence[str]) -> Any:
    """Draw the correlation matrix of the estimated parameters; cells are blank if not known."""
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix = covariance / np.outer(deviations, deviations)
    drawing = empty_figure((0.62 * len(matrix) + 2.5, 0.55 * len(matrix) + 1.5))
    axes = drawing.subplots()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    for (row, column), value in np.ndenumerate(matrix):
        color = "white" if abs(value) > 0.6 else "0.2"
        words = format_number(value, "+.2f")
        axes.text(column, row, words, ha="center", va="center", fontsize=8, color=color)
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    drawing.colorbar(image, shrink=0.8)
    return drawing


def draw_influence(outcome: Outcome[Any, Any], label: str) -> Any:
    """Draw the error of each datum over its leverage, i.e. its influence on the estimate."""
    drawing = empty_figure((10, 4.5))
    axes = drawing.subplots()
    e = outcome.estimate
    kept, leverage = e.weights > 0.0, e.leverage
    used, rejected = (kept, palette.MEASURED, "used"), (~kept, palette.DANGER, "rejected")
    for chosen, color, words in (used, rejected):
        if chosen.any():
            axes.plot(leverage[chosen], e.errors[chosen], "o", color=color, label=words)
    for k, place in enumerate(zip(leverage, e.errors, strict=True)):
        axes.annotate(str(k + 1), place, (5, 4), textcoords="offset points", fontsize=9)
    for check in outcome.checks:
        if check.name == "outliers":
            style = {"color": palette.DANGER, "linestyle": "--", "linewidth": 1.0}
            axes.axhline(check.threshold, label="outliers above", **style)
    mean = float(np.sum(leverage)) / max(int(np.sum(kept)), 1)
    axes.axvline(mean, color="0.5", linestyle=":", label=f"mean leverage, {mean:.2f}")
    axes.set_xlim(0.0, 1.15 * max(float(leverage.max()), mean))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("leverage")
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=9)
    return drawing


def empty_figure(size: tuple[float, float]) -> Any:
    """Return an empty drawing of a size [inches]."""
    from matplotlib.figure import Figure  # slow to import, and needed only for reports

    return Figure(figsize=size, layout="constrained")
