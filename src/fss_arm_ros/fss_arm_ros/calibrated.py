"""The calibrated arm, from calibration messages of rclpy or rosbags."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.layout import BASE_SIZE, LINK_SIZE, kinematic_index, kinematic_names

TOPICS = {
    "calibration/kinematic": "fss_arm_msgs/msg/KinematicCalibration",
    "calibration/dynamic": "fss_arm_msgs/msg/DynamicCalibration",
}

TABLE_TILT = ("g_x", "g_y")  # estimated by a dynamic calibration, but no parameter of the arm


@dataclass(frozen=True)
class Calibrated:
    """An arm with the covariances of its kinematic and of its dynamic calibration."""

    arm: Arm
    kinematic: Floats | None = None  # covariance of Arm.vector(); None: not calibrated
    dynamic: Floats | None = None

    @property
    def covariance(self) -> Floats:
        """Covariance of Arm.vector(), (8 + 6 n, 8 + 6 n); uncalibrated: of the description."""
        size, described = len(self.arm.vector()), self.arm.known
        known = [C for C in (self.kinematic, self.dynamic) if C is not None]
        if not known:
            return vector_covariance(self.arm, described.names, described.covariance)
        return np.sum([np.zeros((size, size)), *known], axis=0)

    def of_same_links(self, topic: str, message: Any) -> "Calibrated":
        """Return `with_message`, but only for an arm with the same number of links.

        Raises:
            ValueError: the number of links differs; see also `with_message`.
        """
        known = self.with_message(topic, message)
        if known.arm.n != self.arm.n:
            raise ValueError(f"it is for {known.arm.n} links, expected {self.arm.n}")
        return known

    def with_message(self, topic: str, message: Any) -> "Calibrated":
        """Return the arm after a calibration: updated if it passed, unchanged otherwise.

        A kinematic calibration estimates no masses, and a dynamic one assumes the kinematics that
        it does not estimate: the result of the other kind is kept.

        Raises:
            DescriptionError: the calibrated description is invalid.
            ValueError: the arm has no such parameter.
        """
        found = message.calibration
        if found.verdict != "pass":
            return self
        arm = from_yaml(found.description)
        C = vector_covariance(arm, found.names, found.covariance) if found.names else None
        other_size = arm.n != self.arm.n
        if topic.endswith("dynamic"):
            has_kinematics = C is not None and _has_kinematics(arm.n, C)
            if other_size or self.kinematic is None or has_kinematics:
                return Calibrated(arm, None, C)
            return Calibrated(with_kinematics_of(self.arm, arm), self.kinematic, C)
        if other_size or self.dynamic is None:
            return Calibrated(arm, C)
        return Calibrated(with_kinematics_of(arm, self.arm), C, self.dynamic)


def with_kinematics_of(known: Arm, arm: Arm) -> Arm:
    """Return `arm` with the kinematics of `known` and their covariance.

    Raises:
        DescriptionError: the two differ in the number of links.
    """
    kinematics = known.vector()[kinematic_index(arm.n)]
    names = [k for k in (*kinematic_names(arm.n), "theta_E") if k in known.known.names]
    own = known.known
    merged = arm.known.updated(names, own.covariance_of(names, np.zeros(len(names))))
    merged = merged.during(own.begin, own.end)
    return replace(arm.with_kinematics(kinematics), theta_E=known.theta_E, known=merged)


def _has_kinematics(n: int, covariance: Floats) -> bool:
    """Return True if lengths or angles were estimated."""
    return bool(np.diag(covariance)[kinematic_index(n)].any())


def vector_covariance(arm: Arm, names: Sequence[str], covariance: npt.ArrayLike) -> Floats:
    """Return the covariance of Arm.vector(), (8 + 6 n, 8 + 6 n), from a calibration's (k, k).

    Args:
        arm: the calibrated arm.
        names: names of the k parameters as in a Calibration message; `a` or `a_1 .. a_3`, and `I`,
            for a value that links share. All other parameters are exact.
        covariance: covariance of the parameters, row by row or as a matrix.

    Raises:
        ValueError: the arm has no parameter of that name.
    """
    columns = [_column(arm, name) for name in names]
    T = np.array(columns).reshape(len(names), len(arm.vector())).T
    return T @ np.reshape(covariance, (len(names), len(names))) @ T.T


def _column(arm: Arm, name: str) -> Floats:
    """Return the derivative of Arm.vector() with respect to a parameter; g = a - b."""
    n = arm.n
    column = np.zeros(BASE_SIZE + LINK_SIZE * n)
    if name in TABLE_TILT:
        return column
    index = dict(zip(kinematic_names(n), kinematic_index(n), strict=True))
    index |= {"m_0": 0, "I_0": 1, "x_com": 2, "y_com": 3, "theta_E": 7}
    for i in range(n):
        first = BASE_SIZE + LINK_SIZE * i
        index |= {f"m_{i + 1}": first + 2, f"I_{i + 1}": first + 3, f"b_{i + 1}": first + 4}
    for one in _members(name, n):
        if one not in index:
            raise ValueError(f"arm {arm.name!r} has no parameter {name!r}")
        column[index[one]] = -1.0 if one.startswith("b_") else 1.0
        if one.startswith("a_"):
            column[index[one] + 4] = 1.0
    return column


def _members(name: str, n: int) -> list[str]:
    """Return the parameters that share one value."""
    if name == "a":  # of all links but the last
        return [f"a_{i}" for i in range(1, max(n, 2))]
    if name in ("m", "b", "I"):
        return [f"{name}_{i}" for i in range(1, n + 1)]
    first, _, last = name.partition(" .. ")
    kind = first.split("_")[0]
    if not last:
        return [name]
    return [f"{kind}_{i}" for i in range(int(first.split("_")[1]), int(last.split("_")[1]) + 1)]
