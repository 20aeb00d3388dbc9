"""Settings of a drift calibration; the same live, in a replay and offline."""

from dataclasses import dataclass
from math import radians
from typing import ClassVar

from fss_arm_calib.segments.settings import DriftFinderSettings, positive, sigma
from fss_arm_calib.settings import CalibrationSettings, max_data
from fss_arm_model.settings import NOT_NEGATIVE, like, setting


@dataclass(frozen=True)
class DriftSettings(DriftFinderSettings, CalibrationSettings):
    """Settings of a drift calibration: detection of drifts, prior knowledge and checks."""

    ABOUT: ClassVar = (
        "Tilt of the table, torque and drag of the hose, from the base's drifts with the arm at "
        "rest."
    )

    arm: str = setting(
        "", "arm with masses and inertias: file or built in (paper, cad, truth); empty: paper"
    )
    max_drifts: int = max_data(30, "drifts")
    position_deviation: float = positive(0.001, "m", "1 sigma of a base position, each axis")
    heading_deviation: float = positive(radians(0.5), "rad", "1 sigma of a heading of the base")
    fresh_rate: float = positive(
        10.0, "Hz", "poses per second that count as independent in an average"
    )
    torque_deviation: float = sigma(
        0.05, "N m", "the hose's constant torque, prior (mean 0); 0: no torque"
    )
    twist_deviation: float = sigma(
        0.01, "N m s", "the hose's resistance to rotation, prior (mean 0); 0: no resistance"
    )
    drag_deviation: float = sigma(
        0.05, "N s/m", "the hose's resistance to translation, prior (mean 0); 0: no resistance"
    )
    com_deviation: float = sigma(
        0.01, "m", "the center of mass of base and arm, each axis, if the description has none"
    )
    mass_deviation: float = setting(
        0.05,
        "relative 1 sigma of mass and inertia of base and arm, if the description has none",
        check=NOT_NEGATIVE,
    )
    outlier: float = like(CalibrationSettings, "outlier", 3.0)
    min_time: float = positive(60.0, "s", "total time of drifts needed to accept a result")
    max_tilt: float = positive(
        radians(0.001), "rad", "largest accepted 1 sigma of the table's tilt"
    )
    max_torque: float = positive(1e-3, "N m", "largest accepted 1 sigma of the hose's torque")
