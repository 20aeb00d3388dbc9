"""The arm as calibrations left it, from their messages: rclpy's and rosbags' alike."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.layout import BASE_SIZE, LINK_SIZE, kinematic_index, kinematic_names

Floats = npt.NDArray[np.float64]

TOPICS = {
    "calibration/kinematic": "fss_arm_msgs/msg/KinematicCalibration",
    "calibration/dynamic": "fss_arm_msgs/msg/DynamicCalibration",
}

OF_THE_TABLE = ("g_x", "g_y")  # its tilt, which a dynamic calibration finds besides


@dataclass(frozen=True)
class Calibrated:
    """An arm, and how well it is known: kinematics by one calibration, dynamics by another."""

    arm: Arm
    kinematic: Floats | None = None  # covariance of Arm.vector(); None: there was none
    dynamic: Floats | None = None

    @property
    def covariance(self) -> Floats:
        """Of Arm.vector(), (8 + 6 n, 8 + 6 n); before any calibration, as the description tells."""
        size, told = len(self.arm.vector()), self.arm.known
        known = [C for C in (self.kinematic, self.dynamic) if C is not None]
        if not known:
            return vector_covariance(self.arm, told.names, told.covariance)
        return np.sum([np.zeros((size, size)), *known], axis=0)

    def of_same_links(self, topic: str, message: Any) -> "Calibrated":
        """As `with_message`, for those who can do with no other number of links.

        Raises:
            ValueError: it is of another, or what `with_message` raises.
        """
        known = self.with_message(topic, message)
        if known.arm.n != self.arm.n:
            raise ValueError(f"it is of {known.arm.n} links, expected {self.arm.n}")
        return known

    def with_message(self, topic: str, message: Any) -> "Calibrated":
        """What is known after a calibration: all that it found if it passed, else the same.

        A kinematic calibration knows nothing of masses, and a dynamic one assumes the kinematics
        that it does not estimate: what the other found before is kept.

        Raises:
            DescriptionError: the calibrated description cannot be right.
            ValueError: a parameter is not the arm's.
        """
        found = message.calibration
        if found.verdict != "pass":
            return self
        arm = from_yaml(found.description)
        C = vector_covariance(arm, found.names, found.covariance) if found.names else None
        of_another = arm.n != self.arm.n
        if topic.endswith("dynamic"):
            has_kinematics = C is not None and _has_kinematics(arm.n, C)
            if of_another or self.kinematic is None or has_kinematics:
                return Calibrated(arm, None, C)
            return Calibrated(with_kinematics_of(self.arm, arm), self.kinematic, C)
        if of_another or self.dynamic is None:
            return Calibrated(arm, C)
        return Calibrated(with_kinematics_of(arm, self.arm), C, self.dynamic)


def with_kinematics_of(known: Arm, arm: Arm) -> Arm:
    """An arm with what a kinematic calibration found of another, and how well.

    Raises:
        DescriptionError: they are of different numbers of links.
    """
    kinematics = known.vector()[kinematic_index(arm.n)]
    names = [k for k in (*kinematic_names(arm.n), "theta_E") if k in known.known.names]
    told = arm.known.told(names, known.known.over(names, np.zeros(len(names))))
    return replace(arm.with_kinematics(kinematics), theta_E=known.theta_E, known=told)


def _has_kinematics(n: int, covariance: Floats) -> bool:
    """Whether lengths or angles are among what was estimated."""
    return bool(np.diag(covariance)[kinematic_index(n)].any())


def vector_covariance(arm: Arm, names: Sequence[str], covariance: npt.ArrayLike) -> Floats:
    """A calibration's covariance, (k, k), as one of Arm.vector(), (8 + 6 n, 8 + 6 n).

    Args:
        arm: the calibrated arm.
        names: of the parameters, as a Calibration message has them; `a` or
            `a_1 .. a_3`, and `I`, for a value that links share. Others are taken as exact.
        covariance: of the parameters, row by row or as a matrix.

    Raises:
        ValueError: a name is no parameter of the arm.
    """
    columns = [_column(arm, name) for name in names]
    T = np.array(columns).reshape(len(names), len(arm.vector())).T
    return T @ np.reshape(covariance, (len(names), len(names))) @ T.T


def _column(arm: Arm, name: str) -> Floats:
    """How Arm.vector() changes with a parameter; g = a - b."""
    n = arm.n
    column = np.zeros(BASE_SIZE + LINK_SIZE * n)
    if name in OF_THE_TABLE:
        return column
    index = dict(zip(kinematic_names(n), kinematic_index(n), strict=True))
    index |= {"m_0": 0, "I_0": 1, "x_com": 2, "y_com": 3, "theta_E": 7}
    for i in range(n):
        first = BASE_SIZE + LINK_SIZE * i
        index |= {f"m_{i + 1}": first + 2, f"I_{i + 1}": first + 3, f"b_{i + 1}": first + 4}
    for one in _members(name, n):
        if one not in index:
            raise ValueError(f"{name!r} is no parameter of {arm.name!r}")
        column[index[one]] = -1.0 if one.startswith("b_") else 1.0
        if one.startswith("a_"):
            column[index[one] + 4] = 1.0
    return column


def _members(name: str, n: int) -> list[str]:
    """The parameters that one value stands for."""
    if name == "a":  # of all links but the last
        return [f"a_{i}" for i in range(1, max(n, 2))]
    if name in ("m", "b", "I"):
        return [f"{name}_{i}" for i in range(1, n + 1)]
    first, _, last = name.partition(" .. ")
    kind = first.split("_")[0]
    if not last:
        return [name]
    return [f"{kind}_{i}" for i in range(int(first.split("_")[1]), int(last.split("_")[1]) + 1)]
