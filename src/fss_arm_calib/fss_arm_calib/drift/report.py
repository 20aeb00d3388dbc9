"""Report of a drift calibration."""

import numpy as np

from fss_arm_calib.acceptance import format_count
from fss_arm_calib.drift.calibrate import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import common_figures, display_name, format_number, make_report
from fss_arm_calib.segments.drifts import Drift
from fss_arm_model.description import Arm
from fss_arm_model.estimation.outliers import expand
from fss_arm_model.units import GRAVITY
from fss_arm_ros.report import Report, Table

#: Explanations of the parameters that follow the two of the tilt.
EXPLANATIONS = "of the hose at rest", "resistance to rotation", "resistance to translation"


def drift_report(outcome: Outcome[Drift, Solution], _: Arm | None = None) -> Report:
    """Report the result of a drift calibration; a description holds none of its parameters."""
    o = outcome
    figures = common_figures(
        o, "drift", "drift", "error predicted from others [standard deviations]"
    )
    title = f"Drift of {o.arm.name}, {format_count(len(o.used), 'drift')}"
    return make_report(title, o, (_parameters(o), _momenta(o)), figures=figures)


def _parameters(outcome: Outcome[Drift, Solution]) -> Table:
    e, found = outcome.estimate, outcome.solution
    torque = found.result.hose_torque if found else (np.nan, np.nan)
    acting = [
        (f"tilt along {axis}", "deg", *np.degrees([e.values[k], e.deviations[k]]) / GRAVITY)
        for k, axis in enumerate("xy")  # acceleration [m/s^2] / g: slope [rad]
    ]
    acting.append(("mean torque of the hose", "N m", *torque))
    acting += [
        (display_name(e.names[k], e, words), e.units[k], e.values[k], e.deviations[k])
        for k, words in enumerate(EXPLANATIONS, 2)
    ]
    rows = [
        [name, unit, *(format_number(number, ".6f") for number in numbers)]
        for name, unit, *numbers in acting
    ]
    weak = [k for k, (*_, value, sigma) in enumerate(acting) if abs(value) <= 2.0 * sigma]
    head = ["", "unit", "estimate", "± 1 sigma"]
    note = (
        "amber: not significant (within two standard deviations of 0); at its bound: the data give "
        "a negative value, so it is not determined."
    )
    title = "External forces and torques on the base"
    return Table(title, head, rows, words=2, note=note, weak=weak)


def _momenta(outcome: Outcome[Drift, Solution]) -> Table:
    found, rows = outcome.solution, []
    momenta = found.result.momenta if found else ()
    values, deviations = (expand(x, found.kept) for x in momenta) if found else ((), ())
    each = zip(outcome.used, values, deviations, strict=bool(found))
    for k, (one, value, deviation) in enumerate(each):
        pairs = (f"{v:#.4g} ± {d:.2g}" for v, d in zip(value, deviation, strict=True))
        fit = f"{outcome.estimate.errors[k]:.2f}", outcome.estimate.reasons[k]
        rows.append([str(k + 1), f"{one.times[-1]:.0f}", *pairs, *fit])
    head = ["drift", "duration [s]", "x [N s]", "y [N s]", "angular [N m s]", "error", "reason"]
    return Table("Momentum at the start of each drift", head, rows)
