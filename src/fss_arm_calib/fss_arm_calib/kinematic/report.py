"""Report of a kinematic calibration."""

from collections.abc import Sequence

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.estimation.noise import assumed_noise
from fss_arm_calib.estimation.statistics import root_mean_square
from fss_arm_calib.kinematic.figures import (
    PAPER_HEADING_RESIDUAL,
    PAPER_POSITION_RESIDUAL,
    postures,
)
from fss_arm_calib.kinematic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report import Figure, Report, Table
from fss_arm_calib.report_figures import draw_correlation, draw_influence
from fss_arm_calib.report_tables import (
    difference,
    display_unit,
    format_number,
    format_value,
    make_report,
)
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.layout import kinematic_index, kinematic_names


def kinematic_report(outcome: Outcome[Observation, Solution], truth: Arm | None = None) -> Report:
    """Report the result of a kinematic calibration, beside the true values if known."""
    o = outcome
    labels = [_label(name, o.arm.n) for name in o.names]
    figures = (
        Figure("kinematic_postures", "Postures and residuals", lambda: postures(o)),
        Figure(
            "kinematic_correlation",
            "Correlation of the parameters",
            lambda: draw_correlation(o.covariance, labels),
        ),
        Figure(
            "kinematic_observations",
            "Each observation",
            lambda: draw_influence(o, "normalized residual [deviations]"),
        ),
    )
    title, tables = f"Kinematic calibration of {o.arm.name}", (_parameters(o, truth), _residuals(o))
    details = (_observations(o),) if o.solution else ()
    return make_report(title, o, tables, details, figures)


def _parameters(outcome: Outcome[Observation, Solution], truth: Arm | None) -> Table:
    """Tabulate the parameters beside the paper's Tables 2-3 and, if known, the true values."""
    e, n, p = outcome.estimate, outcome.arm.n, len(outcome.names)
    paper = _values(paper_arm(), e.names) if n == paper_arm().n else np.full(p, np.nan)
    true = np.full(p, np.nan) if truth is None else _values(truth, e.names)
    known = truth is not None
    rows = []
    for k, (name, unit) in enumerate(zip(e.names, e.units, strict=True)):
        columns = [paper, e.initial, *[true] * known, e.values, e.deviations]
        row = [_label(name, n), display_unit(unit)]
        row += [format_value(column[k], unit) for column in columns]
        if known:
            row.append(
                format_number(difference(e.values[k], true[k], unit) / e.deviations[k], "+.2f")
            )
        rows.append(row)
    head = ["parameter", "unit", "Tables 2-3", "guess", *["truth"] * known, "estimate", "± 1 sigma"]
    head += ["error / sigma"] * known
    note, weak = "", list[int]()
    if found := outcome.solution:
        note = "amber: more than three times as uncertain as the end effector in one observation."
        one = dict(zip(("m", "rad"), found.noise.deviations, strict=True))
        weak = [k for k, unit in enumerate(e.units) if not e.deviations[k] < 3 * one[unit]]
    return Table("Parameters", head, rows, words=2, note=note, weak=weak)


def _residuals(outcome: Outcome[Observation, Solution]) -> Table:
    e, found = outcome.estimate, outcome.solution
    noise = found.noise if found else assumed_noise(outcome.settings)
    predicted = found.prediction.residuals if found else np.empty((0, 3))
    rows = [
        [name, display_unit(unit), *(format_value(value, unit) for value in values)]
        for name, unit, *values in (
            ("position", "m", PAPER_POSITION_RESIDUAL, e.position_residual,
             root_mean_square(predicted[:, :2]), noise.deviations[0]),
            ("heading", "rad", PAPER_HEADING_RESIDUAL, e.heading_residual,
             root_mean_square(predicted[:, 2]), noise.deviations[1]),
        )
    ]  # fmt: skip
    head = ["end effector", "unit", "paper", "this result", "predicted", "assumed error"]
    note = (
        "predicted: held-out observations, by a solution without them; assumed error: of an "
        f"observation, {'as given' if noise.is_given.all() else f'estimated: {noise}'}."
    )
    return Table("Standard deviation of the residuals", head, rows, words=2, note=note)


def _observations(outcome: Outcome[Observation, Solution]) -> Table:
    e, found, n = outcome.estimate, outcome.solution, outcome.arm.n
    held_out = found.held_out.tolist() if found else []
    rows = []
    for k, (o, residual) in enumerate(zip(outcome.used, e.residuals, strict=True)):
        states = [e.reasons[k]] if e.reasons[k] else []
        states += ["held out for the prediction"] if k in held_out else []
        rows.append([
            str(k + 1),
            *(f"{angle:.2f}" for angle in np.degrees(o.q)),
            *(f"{x:.4f}" for x in o.tip[:2]), f"{np.degrees(o.tip[2]):.2f}",
            *(f"{1e3 * x:+.1f}" for x in residual[:2]), f"{np.degrees(residual[2]):+.3f}",
            f"{e.errors[k]:.2f}", f"{e.leverage[k]:.2f}", f"{e.weights[k]:.2f}",
            "; ".join(states),
        ])  # fmt: skip
    head = [
        "", *(f"q_{i} [deg]" for i in range(1, n + 1)), "x [m]", "y [m]", "heading [deg]",
        "dx [mm]", "dy [mm]", "dheading [deg]", "normalized", "leverage", "weight", "",
    ]  # fmt: skip
    note = (
        "Joint readings; pose of the end effector relative to the base; residual (observed minus "
        "predicted), its length in its standard deviations; leverage on its own prediction."
    )
    return Table("Observations", head, rows, note=note)


def _values(arm: Arm, names: Sequence[str]) -> Floats:
    """Return an arm's values of the named parameters; NaN for those it does not have."""
    values = arm.vector()[kinematic_index(arm.n)]
    known = dict(zip(kinematic_names(arm.n), values, strict=True))
    known["a"] = float(np.mean(values[: max(arm.n - 1, 1)]))
    known["theta_E"] = arm.theta_E
    return np.array([known.get(name, np.nan) for name in names])


def _label(name: str, n: int) -> str:
    return f"a_1 .. a_{n - 1}" if name == "a" else name
