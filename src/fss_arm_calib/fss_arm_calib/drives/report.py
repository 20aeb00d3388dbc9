"""Report of a calibration of drives: parameters, refused parameters and reasons."""

from typing import Any

import numpy as np

from fss_arm_calib.drives.problem import NAMES, Drive
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import format_number, make_report
from fss_arm_model.description import Arm
from fss_arm_ros.report import Report, Table


def drives_report(outcome: Outcome[Any, list[Drive]], truth: Arm | None = None) -> Report:
    """Report the calibration; `truth` is the simulated arm to compare with."""
    title, found = f"Drive parameters of {outcome.arm.name}", outcome.solution
    tables = [_parameters(outcome, truth), *([_undetermined(found)] if found else [])]
    return make_report(title, outcome, tables, [_data(found)] if found else [])


def _parameters(outcome: Outcome[Any, list[Drive]], truth: Arm | None) -> Table:
    """Tabulate the parameters that are determined, beside the true values if known."""
    e, rows, weak = outcome.estimate, list[list[str]](), list[int]()
    true = {}
    for i, link in enumerate(truth.links if truth else (), 1):
        true[f"torque_constant_{i}"] = link.drive.torque_constant
        true[f"torque_gain_{i}"] = link.torque_sensor.gain
    each = zip(e.names, e.units, e.initial, e.values, e.deviations, strict=True)
    for name, unit, guess, value, sigma in each:
        if np.isnan(value):
            continue
        if abs(value) <= 2.0 * sigma:
            weak.append(len(rows))
        numbers = [(guess, ".4g"), (value, ".4g"), (sigma, ".2g")]
        if truth:
            numbers.append(((value - true.get(name, np.nan)) / sigma, "+.1f"))
        rows.append([name, unit, *(format_number(*number) for number in numbers)])
    head = ["parameter", "unit", "guess", "estimate", "± 1 sigma", *["off [sigma]"] * bool(truth)]
    note = (
        "The described masses set the scale of the torques; amber: not significant (within two "
        "standard deviations of 0)."
    )
    return Table("Parameters", head, rows, 2, note, weak)


def _undetermined(found: list[Drive]) -> Table:
    """Tabulate the undetermined parameters; joints with the same reason share a row."""
    joints: dict[tuple[str, str], list[str]] = {}
    for i, one in enumerate(found, 1):
        for name, reason in one.undetermined.items():
            joints.setdefault((name, reason), []).append(str(i))
    order = list(NAMES)
    every = sorted(joints.items(), key=lambda row: (order.index(row[0][0]), row[1]))
    rows = [[name, ", ".join(which), reason] for (name, reason), which in every]
    head = ["parameter", "joints", "reason"]
    return Table("Parameters not determined by these data", head, rows, 3)


def _data(found: list[Drive]) -> Table:
    rows = [
        [str(i), f"{one.moving:.1f}", *(format_number(1e3 * x, ".2f") for x in one.residuals)]
        for i, one in enumerate(found, 1)
    ]
    head = ["joint", "time in motion [s]", "torque residual [mN m]", "current residual [mA]"]
    return Table("Data", head, rows)
