"""Report of a dynamic calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fss_arm_calib.dynamic.figures import draw_motion, draw_residuals
from fss_arm_calib.dynamic.parameters import Choice
from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report import Figure, Report, Table
from fss_arm_calib.report_figures import common_figures
from fss_arm_calib.report_tables import (
    format_number,
    format_value,
    make_report,
    mask_undetermined,
    parameter_table,
    relative_errors,
)
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.files import ContentError, read_yaml
from fss_arm_model.parameters import values

PAPER_HEADING_RESIDUAL = float(np.radians(1.54))  # section 4.2


def dynamic_report(outcome: Outcome[Maneuver, Solution], truth: Arm | None = None) -> Report:
    """Report the result of a dynamic calibration, beside the true values if known."""
    o, found = outcome, outcome.solution
    figures = (
        Figure("dynamic_motion", "Base motion, predicted and measured", lambda: draw_motion(o)),
        Figure("dynamic_residuals", "Residuals of the base's poses", lambda: draw_residuals(o)),
        *common_figures(o, "dynamic", "maneuver", "error predicted from others [deviations]"),
    )
    tables = (_parameter_table(o, truth), _combination_table(o), _residual_table(o))
    details = (
        (_maneuver_table(o, found), _direction_table(o, found), _bias_table(o, found))
        if found
        else ()
    )
    return make_report(f"Dynamic calibration of {o.arm.name}", o, tables, details, figures)


def _parameter_values(arm: Arm, names: Sequence[str]) -> Floats:
    """Return an arm's values of the named parameters, averaged where several share one."""

    def value(name: str) -> float:
        try:
            return float(np.mean(values(arm)[Choice.of(name, arm.n).indices]))
        except ValueError:  # a parameter of the table, or of a link that the arm does not have
            return np.nan

    return np.array([value(name) for name in names])


def _read_promised(plan: str) -> Mapping[str, float]:
    """Return the standard deviations that a plan of `design` promised, by name.

    Raises:
        ContentError: the file is not such a plan.
        OSError: the file cannot be read.
    """
    found = read_yaml(Path(plan))
    if not isinstance(found, dict) or "maneuvers" not in found:
        raise ContentError(f"plan {plan}", found, "maneuvers, as `design` writes them")
    given = found.get("promised", {})
    if not isinstance(given, dict) or not all(isinstance(x, float | int) for x in given.values()):
        raise ContentError(f"plan {plan}: promised", given, "deviations by name")
    return given


def _parameter_table(outcome: Outcome[Maneuver, Solution], truth: Arm | None) -> Table:
    """Tabulate the parameters beside the paper's Table 4 and, if known, the true values."""
    e, paper = outcome.estimate, paper_arm()
    r = outcome.solution.result if outcome.solution else None
    share = mask_undetermined(e, r.prior_share if r else e.deviations)
    columns = {
        "Table 4": _parameter_values(paper, e.names)
        * (1.0 if outcome.arm.n == paper.n else np.nan),
        "guess": e.initial,
        **({"truth": _parameter_values(truth, e.names)} if truth else {}),
        "estimate": e.values,
    }
    if plan := outcome.settings.plan:
        promised = _read_promised(plan)
        columns["promised ±"] = np.array([promised.get(name, np.nan) for name in e.names])
    columns["± 1 sigma"] = e.deviations
    columns["random"] = mask_undetermined(e, np.sqrt(np.diag(r.random)) if r else e.deviations)
    ratios = {"prior [%]": (100.0 * share, ".0f")}
    if truth:
        ratios["error / sigma"] = relative_errors(e, columns["truth"]), "+.2f"
    note = (
        "random: the deviation without the uncertainty of assumed parameters; prior: share of the "
        "value from prior knowledge; amber: mostly from prior knowledge, or at its bound."
    )
    weak = [k for k, name in enumerate(e.names) if share[k] > 0.5 or name in e.at_bound]
    table = parameter_table(outcome, columns, ratios, note=note, weak=weak)
    return replace(table, detailed=["Table 4", "random", "prior [%]"])


def _combination_table(outcome: Outcome[Maneuver, Solution]) -> Table:
    rows = [
        [c.name, c.unit, *(format_value(x, c.unit) for x in (c.value, c.deviation, c.before))]
        for c in (outcome.solution.combinations if outcome.solution else ())
    ]
    head = ["combination", "unit", "estimate", "± 1 sigma", "± before"]
    note = (
        "The motion depends only on these if base and kinematics are known: m = sum m_k, "
        "S_j = m_j g_j + a_j sum m_k, K_j = I_j + m_j g_j² + a_j² sum m_k, k > j."
    )
    return Table("Link parameters that motion determines", head, rows, words=2, note=note)


def _residual_table(outcome: Outcome[Maneuver, Solution]) -> Table:
    rows = [
        ["position", "m", "-", format_value(outcome.estimate.position_residual, "m")],
        [
            "heading",
            "deg",
            format_value(PAPER_HEADING_RESIDUAL, "rad"),
            format_value(outcome.estimate.heading_residual, "rad"),
        ],
    ]
    head = ["base", "unit", "paper", "this result"]
    return Table("Standard deviation of the residuals", head, rows, words=2)


def _maneuver_table(outcome: Outcome[Maneuver, Solution], found: Solution) -> Table:
    e = outcome.estimate
    rows = [
        [
            str(k + 1),
            *(format_number(value, "+#.4g") for value in momentum),
            f"{e.leverage[k]:.2f}",
            format_number(e.errors[k], ".2f"),
            f"{e.weights[k]:.2f}",
            e.reasons[k],
        ]
        for k, momentum in enumerate(found.momenta)
    ]
    head = ["", "p_x [N s]", "p_y [N s]", "L [N m s]", "leverage", "error", "weight", ""]
    note = (
        "Momentum at the start; error of the maneuver predicted from the others, in its deviations."
    )
    return Table("Maneuvers", head, rows, note=note)


def _direction_table(outcome: Outcome[Maneuver, Solution], found: Solution) -> Table:
    """Tabulate the combinations of parameters, least observed first."""
    rows = [
        [one.kind, one.text(outcome.names), format_number(one.gain, ".3g")]
        for one in sorted(found.directions, key=lambda one: one.gain)
    ]
    note = "gain: reduction of the prior uncertainty by the data alone."
    head = ["visibility", "combination", "gain"]
    return Table("Visibility of combinations of parameters", head, rows, words=2, note=note)


def _bias_table(outcome: Outcome[Maneuver, Solution], found: Solution) -> Table:
    """Tabulate the bias by wrong assumptions, in standard deviations of the parameters."""
    bias = found.result.bias / outcome.deviations[:, None]
    rows = [
        [name, *(format_number(value, "+.2f") for value in row)]
        for name, row in zip(outcome.names, bias, strict=True)
    ]
    note = (
        "Shift of each value, in its deviations, if an assumed parameter is truly 1 sigma higher."
    )
    return Table(
        "Bias due to assumed parameters", ["", *found.result.assumed_names], rows, note=note
    )
