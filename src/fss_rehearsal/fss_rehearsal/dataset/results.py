"""Results of the calibrations on the data set, and of plain least squares, against the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS as CALIBRATIONS
from fss_arm_calib.outcome import Outcome
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.layout import kinematic_index, kinematic_names
from fss_arm_model.parameters import parameter_names, values
from fss_arm_ros.calibrated import with_kinematics_of
from fss_rehearsal.dataset import least_squares
from fss_rehearsal.dataset.arms import ArmPair
from fss_rehearsal.dataset.bags import DRIFT_TRUTH, KINDS
from fss_sim.plant.joints import PRESETS as JOINTS
from fss_sim.settings import TestbedSettings

OWN_METHOD, PLAIN_METHOD = "fss_arm_calib", "plain least squares"
WITHIN_95 = 1.96  # standard deviations of the 95 % interval
#: Kinds of parameters in the table: starts of their names, factor to the unit, unit.
QUANTITIES = {
    "kinematic": ((("a_", "x_", "y_"), 1e3, "mm"), (("theta_",), np.degrees(1.0), "deg")),
    "dynamic": ((("b_", "x_", "y_"), 1e3, "mm"), (("I_",), 1e3, "g m²")),
    "drift": ((("g_",), 1e3, "mm/s²"), (("drag",), 1e3, "mN s/m"), (("twist_",), 1e3, "mN m s")),
    "drives": (
        (("torque_constant_",), 1e3, "mN m/A"),
        (("viscous_",), 1e3, "mN m s"),
        (("coulomb_",), 1e3, "mN m"),
    ),
}


@dataclass(frozen=True)
class Estimates:
    """Estimates of one bag by one method: errors and standard deviations, (k,) each [SI]."""

    kind: str
    preset: str
    method: str
    passed: bool
    seconds: float  # of the computation
    names: tuple[str, ...]
    errors: Floats
    deviations: Floats


def true_values(kind: str, preset: str, arm: Arm) -> dict[str, float]:
    """Return the true value of each parameter that is known exactly, by name."""
    if kind == "drift":
        return DRIFT_TRUTH
    if kind != "drives":
        return dict(zip(parameter_names(arm.n), values(arm).tolist(), strict=True))
    joints, found = JOINTS[preset], {}
    for i, link in enumerate(arm.links, 1):
        found[f"torque_constant_{i}"] = link.drive.torque_constant
        found[f"torque_gain_{i}"] = link.torque_sensor.gain
        found |= {
            f"{name}_{i}": getattr(joints, name)
            for name in ("viscous", "coulomb", "static", "stribeck_speed")
        }
    return found


def compare(
    names: Sequence[str], found: Floats, deviations: Floats, true: Mapping[str, float]
) -> tuple[tuple[str, ...], Floats, Floats]:
    """Return names, errors and deviations of the determined parameters whose truth is known."""
    chosen = [k for k, name in enumerate(names) if name in true and 0.0 < deviations[k] < np.inf]
    own = tuple(names[k] for k in chosen)
    errors = np.array([found[k] - true[names[k]] for k in chosen])
    angles = np.array([name.startswith("theta") for name in own], dtype=bool)
    errors[angles] = (errors[angles] + np.pi) % (2.0 * np.pi) - np.pi
    return own, errors, np.asarray(deviations)[chosen]


def evaluate(folder: Path, description: Path, preset: str, pair: ArmPair) -> list[Estimates]:
    """Calibrate from the bags of an arm with a preset, each kind with the results before it."""
    found, arm = [], pair.described
    for kind in KINDS:
        calibration, start = CALIBRATIONS[kind], perf_counter()
        given = {"rotor_inertia": JOINTS[preset].rotor_inertia} if kind == "drives" else {}
        settings = calibration.settings(arm=str(description), **given)
        outcome: Outcome[Any, Any] = solve_bag(calibration, folder / kind, settings, arm=arm)
        seconds = perf_counter() - start
        true = true_values(kind, preset, pair.truth)
        compared = compare(outcome.names, outcome.values, outcome.deviations, true)
        passed = outcome.verdict == PASS
        found.append(Estimates(kind, preset, OWN_METHOD, passed, seconds, *compared))
        if kind == "kinematic":
            found.append(evaluate_plain(folder / kind, preset, pair))
        if passed and kind in ("kinematic", "dynamic"):
            calibrated = from_yaml(outcome.description)
            arm = with_kinematics_of(calibrated, arm) if kind == "kinematic" else calibrated
    return found


def evaluate_plain(bag: Path, preset: str, pair: ArmPair) -> Estimates:
    """Estimate the kinematics from a bag by plain least squares."""
    start, n = perf_counter(), pair.truth.n
    topics = [f"/{topic}" for topic in (TestbedSettings.base_topic, TestbedSettings.tip_topic)]
    rests = least_squares.rests(least_squares.read(bag), *topics)
    estimate = least_squares.fit(*rests, pair.described.vector()[kinematic_index(n)])
    seconds, true = perf_counter() - start, true_values("kinematic", preset, pair.truth)
    compared = compare(kinematic_names(n), *estimate, true)
    return Estimates("kinematic", preset, PLAIN_METHOD, True, seconds, *compared)


def results_table(estimates: Sequence[Estimates]) -> list[list[str]]:
    """Return a row for each kind, preset and method, as text; the first row is the head.

    Errors are those of the results that passed.
    """
    head = ["kind", "preset", "method", "passed", "values", "median error", "95 % coverage"]
    rows = [[*head, "RMS error [deviations]", "time [s]"]]
    for key in dict.fromkeys((one.kind, one.preset, one.method) for one in estimates):
        every = [one for one in estimates if (one.kind, one.preset, one.method) == key]
        group = [one for one in every if one.passed]
        names = [name for one in group for name in one.names]
        errors = np.array([error for one in group for error in one.errors])
        ratios = errors / [deviation for one in group for deviation in one.deviations]
        passed = "" if key[2] == PLAIN_METHOD else f"{len(group)} of {len(every)}"
        row = [*key, passed, str(len(names)), median_errors(key[0], names, errors)]
        if names:
            coverage, rms = np.mean(np.abs(ratios) < WITHIN_95), np.sqrt(np.mean(ratios**2))
            row += [f"{100.0 * coverage:.0f} %", f"{rms:.2f}"]
        else:
            row += ["", ""]
        rows.append([*row, f"{np.median([one.seconds for one in every]):.1f}"])
    return rows


def median_errors(kind: str, names: Sequence[str], errors: Floats) -> str:
    """Return the median absolute error of each quantity of a kind, with units."""
    found = []
    for starts, factor, unit in QUANTITIES[kind]:
        chosen = [abs(e) for name, e in zip(names, errors, strict=True) if name.startswith(starts)]
        if chosen:
            found.append(f"{factor * np.median(chosen):.2g} {unit}")
    return ", ".join(found)
