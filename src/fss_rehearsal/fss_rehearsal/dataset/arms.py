"""Arms of the data set: the truth, and what a laboratory knows of it from drawings and scales."""

from dataclasses import dataclass, replace

import numpy as np

from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_model.description import Arm, Base, Drive, Link, TorqueSensor
from fss_arm_model.parameters import parameter_names, values, with_values

LINKS = {"a": 2, "b": 3, "c": 4, "d": 5, "e": 6}  # number of links of each arm
BLIND = "d", "e"  # arms whose truth is not part of the data set
#: Largest errors of a drawing, by kind of parameter: lengths [m], angles [rad], of b [m].
DRAWING_ERRORS = {"a": 0.005, "theta": 0.05, "x": 0.005, "y": 0.005, "b": 0.015}
INERTIA_ERROR = 0.25  # largest relative error of a link's inertia from drawings


@dataclass(frozen=True)
class ArmPair:
    """An arm and its description."""

    truth: Arm
    described: Arm


def draw_truth(name: str, n: int, rng: np.random.Generator) -> Arm:
    """Return a random arm of n different links, the outer ones lighter."""
    links = []
    scale = min(1.0, 5.0 / n)  # a longer arm would not have enough room on the table
    for i in range(n):
        a, mass = scale * rng.uniform(0.25, 0.4), rng.uniform(1.8, 3.0) * (1.0 - 0.06 * i)
        drive = Drive(torque_constant=0.8 * rng.uniform(0.93, 1.07))
        sensor = TorqueSensor(gain=2.1 / 2**23 * rng.uniform(0.96, 1.04))
        links.append(
            Link(
                a=a,
                theta_0=rng.uniform(-0.1, 0.1) if i else 0.0,
                mass=mass,
                b=a * rng.uniform(0.4, 0.6),
                inertia=mass * a**2 * rng.uniform(0.09, 0.14),
                drive=drive,
                torque_sensor=sensor,
            )
        )
    mount = rng.uniform(0.15, 0.25), rng.uniform(-0.05, 0.05), rng.uniform(-0.3, 0.3)
    base = Base(rng.uniform(9.0, 12.0), rng.uniform(0.2, 0.35), mount=mount)
    return Arm(name, base, tuple(links))


def describe(truth: Arm, rng: np.random.Generator) -> Arm:
    """Return the description from which calibrations start.

    Masses and the base differ from the truth by the deviations that a dynamic calibration assumes,
    all others by up to the errors of a drawing. Drives and torque sensors are nominal.
    """
    names, true = parameter_names(truth.n), values(truth)
    off = DynamicSettings().deviations(truth) * rng.standard_normal(len(names))
    for k, name in enumerate(names):
        kind = name.split("_")[0]
        if kind in DRAWING_ERRORS and not name.endswith("com"):
            off[k] = DRAWING_ERRORS[kind] * rng.uniform(-1.0, 1.0)
        elif kind == "I" and name != "I_0":
            off[k] = INERTIA_ERROR * true[k] * rng.uniform(-1.0, 1.0)
    found = with_values(truth, true + off)
    links = [replace(link, drive=Drive(), torque_sensor=TorqueSensor()) for link in found.links]
    return replace(found, links=tuple(links))


def draw_pair(name: str, seed: int) -> ArmPair:
    """Return the arm of this name and its description."""
    rng = np.random.default_rng([seed, ord(name)])
    truth = draw_truth(f"arm_{name}", LINKS[name], rng)
    return ArmPair(truth, describe(truth, rng))
