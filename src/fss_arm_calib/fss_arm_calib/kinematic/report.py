"""Report of a kinematic calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

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
from fss_arm_calib.report_figures import common_figures
from fss_arm_calib.report_tables import (
    display_unit,
    format_value,
    make_report,
    parameter_table,
    relative_errors,
)
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.layout import kinematic_index, kinematic_names


def kinematic_report(outcome: Outcome[Observation, Solution], truth: Arm | None = None) -> Report:
    """Report the result of a kinematic calibration, beside the true values if known."""
    o = outcome
    labels = {"a": f"a_1 .. a_{o.arm.n - 1}"}
    each, correlation = common_figures(
        o,
        "kinematic",
        "observation",
        "normalized residual [deviations]",
        [labels.get(name, name) for name in o.names],
    )
    drawn = Figure("kinematic_postures", "Postures and residuals", lambda: postures(o))
    tables = (_parameters(o, truth, labels), _residuals(o))
    details = (_observations(o),) if o.solution else ()
    title = f"Kinematic calibration of {o.arm.name}"
    return make_report(title, o, tables, details, (drawn, correlation, each))


def _parameters(
    outcome: Outcome[Observation, Solution], truth: Arm | None, labels: Mapping[str, str]
) -> Table:
    """Tabulate the parameters beside the paper's Tables 2-3 and, if known, the true values."""
    e, paper = outcome.estimate, paper_arm()
    columns = {
        "Tables 2-3": _values(paper, e.names) * (1.0 if outcome.arm.n == paper.n else np.nan),
        "guess": e.initial,
        **({"truth": _values(truth, e.names)} if truth else {}),
        "estimate": e.values,
        "± 1 sigma": e.deviations,
    }
    ratios = {"error / sigma": (relative_errors(e, columns["truth"]), "+.2f")} if truth else {}
    note, weak = "", list[int]()
    if found := outcome.solution:
        note = "amber: more than three times as uncertain as the end effector in one observation."
        one = dict(zip(("m", "rad"), found.noise.deviations, strict=True))
        weak = [k for k, unit in enumerate(e.units) if not e.deviations[k] < 3 * one[unit]]
    table = parameter_table(outcome, columns, ratios, labels, note, weak)
    return replace(table, detailed=["Tables 2-3"])


def _residuals(outcome: Outcome[Observation, Solution]) -> Table:
    e, found = outcome.estimate, outcome.solution
    noise = found.noise if found else assumed_noise(outcome.settings)
    predicted = found.prediction.residuals if found else np.empty((0, 3))
    rows = [
        [name, display_unit(unit), *(format_value(value, unit) for value in values)]
        for name, unit, *values in (
            (
                "position",
                "m",
                PAPER_POSITION_RESIDUAL,
                e.position_residual,
                root_mean_square(predicted[:, :2]),
                noise.deviations[0],
            ),
            (
                "heading",
                "rad",
                PAPER_HEADING_RESIDUAL,
                e.heading_residual,
                root_mean_square(predicted[:, 2]),
                noise.deviations[1],
            ),
        )
    ]
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
        rows.append(
            [
                str(k + 1),
                *(f"{angle:.2f}" for angle in np.degrees(o.q)),
                *(f"{x:.4f}" for x in o.tip[:2]),
                f"{np.degrees(o.tip[2]):.2f}",
                *(f"{1e3 * x:+.1f}" for x in residual[:2]),
                f"{np.degrees(residual[2]):+.3f}",
                f"{e.errors[k]:.2f}",
                f"{e.leverage[k]:.2f}",
                f"{e.weights[k]:.2f}",
                "; ".join(states),
            ]
        )
    head = [
        "",
        *(f"q_{i} [deg]" for i in range(1, n + 1)),
        "x [m]",
        "y [m]",
        "heading [deg]",
        "dx [mm]",
        "dy [mm]",
        "dheading [deg]",
        "normalized",
        "leverage",
        "weight",
        "",
    ]
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
