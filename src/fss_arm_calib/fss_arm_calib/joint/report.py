"""Report of a joint estimate: the arm, the share of each kind of data, and the sessions."""

from dataclasses import replace
from typing import Any

import numpy as np

from fss_arm_calib.joint.calibrate import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import (
    display_unit,
    make_report,
    mask_undetermined,
    parameter_table,
    relative_errors,
)
from fss_arm_model.description import Arm
from fss_arm_model.estimation.statistics import probability
from fss_arm_model.parameters import values
from fss_arm_ros.report import Report, Table


def joint_report(outcome: Outcome[Any, Solution], truth: Arm | None = None) -> Report:
    """Report the joint estimate; `truth` is the simulated arm to compare with."""
    found = outcome.solution
    title = f"Joint estimate of {outcome.arm.name}"
    if found is None:
        return make_report(title, outcome, [parameter_table(outcome)])
    tables = [_parameter_table(outcome, found, truth), _fit_table(found)]
    return make_report(title, outcome, tables, [_session_table(found)])


def _parameter_table(outcome: Outcome[Any, Solution], found: Solution, truth: Arm | None) -> Table:
    """Tabulate guess, estimate, and by how much the deviation grows without a kind of data."""
    r, e = found.result, outcome.estimate
    sigma = mask_undetermined(e, e.deviations)
    ratios = {f"x without {kind}": (x / sigma, ".2f") for kind, x in r.without.items()}
    if truth:
        true = np.array([*values(truth), truth.theta_E])[: len(e.names)]
        ratios["off [sigma]"] = relative_errors(e, true), "+.1f"
    note = (
        "x: growth of the deviation without the data of a kind; -: only these data determine it; "
        "amber: the guess is as informative as all data, or the value is at its bound."
    )
    weak = np.flatnonzero(~(2.0 * e.deviations**2 < r.problem.prior_deviations**2)).tolist()
    table = parameter_table(outcome, ratios=ratios, note=note, weak=weak)
    return replace(table, detailed=[name for name in ratios if name.startswith("x without")])


def _fit_table(found: Solution) -> Table:
    rows = []
    for kind, (cost, free) in found.result.fits.items():
        number = sum(one.get(kind, 0) for one in found.number)
        chance = f"{probability(cost, free):.2g}"
        rows.append([kind, str(number), f"{cost:.1f}", str(free), chance])
    head = ["kind", "data", "chi-square", "observations minus own unknowns", "probability"]
    return Table("Residuals by kind of data", head, rows)


def _session_table(found: Solution) -> Table:
    rows = []
    for one in found.session_parameters():
        numbers = np.array([one.value, one.deviation])
        shown = np.degrees(numbers) if one.unit == "rad" else numbers
        texts = (f"{x:.3g}" for x in shown)
        rows.append([one.session, one.name, display_unit(one.unit), *texts])
    head = ["session", "parameter", "unit", "estimate", "± 1 sigma"]
    note = "zeros of joints relative to those of the last session"
    return Table("Parameters of each session", head, rows, words=3, note=note)
