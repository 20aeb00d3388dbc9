"""Report of a calibration of drives: parameters, refused parameters and reasons."""

from typing import Any

import numpy as np

from fss_arm_calib.drives.problem import NAMES, Drive
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report import Report, Table
from fss_arm_calib.report_tables import format_number, make_report
from fss_arm_model.description import Arm


def drives_report(outcome: Outcome[Any, list[Drive]], truth: Arm | None = None) -> Report:
    """Report the calibration; `truth` is the simulated arm to compare with."""
    title = f"Drive parameters of {outcome.arm.name}"
    found = outcome.solution
    tables = [_parameters(outcome, truth)]
    if found is None:
        return make_report(title, outcome, tables)
    return make_report(title, outcome, [*tables, _undetermined(found)], [_data(found)])


def _parameters(outcome: Outcome[Any, list[Drive]], truth: Arm | None) -> Table:
    e = outcome.estimate
    true = {}
    for i, link in enumerate(truth.links if truth else (), 1):
        true[f"torque_constant_{i}"] = link.drive.torque_constant
        true[f"torque_gain_{i}"] = link.torque_sensor.gain
    rows: list[list[str]] = []
    weak: list[int] = []
    for name, unit, *numbers in zip(
        e.names, e.units, e.initial, e.values, e.deviations, strict=True
    ):
        if np.isnan(numbers[1]):
            continue
        off = (numbers[1] - true.get(name, np.nan)) / numbers[2]
        rows.append(
            [
                name,
                unit,
                *(format_number(x, ".4g") for x in numbers[:2]),
                format_number(numbers[2], ".2g"),
            ]
        )
        if abs(numbers[1]) <= 2.0 * numbers[2]:
            weak.append(len(rows) - 1)
        if truth:
            rows[-1].append(format_number(off, "+.1f"))
    head = ["parameter", "unit", "guess", "estimate", "± 1 sigma"]
    note = (
        "The described masses set the scale of the torques; amber: not significant (within two "
        "standard deviations of 0)."
    )
    return Table("Parameters", head + (["off [sigma]"] if truth else []), rows, 2, note, weak)


def _undetermined(found: list[Drive]) -> Table:
    """Tabulate the undetermined parameters; joints with the same reason share a row."""
    joints: dict[tuple[str, str], list[str]] = {}
    for i, one in enumerate(found, 1):
        for name, reason in one.undetermined.items():
            joints.setdefault((name, reason), []).append(str(i))
    order = list(NAMES)
    rows = [
        [name, ", ".join(which), reason]
        for (name, reason), which in sorted(
            joints.items(), key=lambda row: (order.index(row[0][0]), row[1])
        )
    ]
    return Table(
        "Parameters not determined by these data", ["parameter", "joints", "reason"], rows, 3
    )


def _data(found: list[Drive]) -> Table:
    rows = [
        [str(i), f"{one.moving:.1f}", *(format_number(1e3 * x, ".2f") for x in one.residuals)]
        for i, one in enumerate(found, 1)
    ]
    head = ["joint", "time in motion [s]", "torque residual [mN m]", "current residual [mA]"]
    return Table("Data", head, rows)
