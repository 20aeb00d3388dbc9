"""Settings of a drift calibration; the same live, in a replay and offline."""

from dataclasses import dataclass
from math import radians
from typing import ClassVar

from fss_arm_calib.segments.settings import DriftFinderSettings
from fss_arm_calib.settings import CalibrationSettings, max_data
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, setting


@dataclass(frozen=True)
class DriftSettings(DriftFinderSettings, CalibrationSettings):
    """Settings of a drift calibration: detection of drifts, prior knowledge and checks."""

    ABOUT: ClassVar = (
        "Tilt of the table, torque and drag of the hose, from the base's drifts with the arm at "
        "rest."
    )

    arm: str = setting("", "description YAML of masses and inertias; empty: the paper's arm")
    max_drifts: int = max_data(30, "drifts")
    position_deviation: float = setting(
        0.001, "1 sigma of a position of the base, each axis", unit="m", check=POSITIVE
    )
    heading_deviation: float = setting(
        radians(0.5), "1 sigma of a heading of the base", unit="rad", check=POSITIVE
    )
    fresh_rate: float = setting(
        10.0,
        "rate of poses with independent errors, for the deviation of averages",
        unit="Hz",
        check=POSITIVE,
    )
    torque_deviation: float = setting(
        0.05,
        "1 sigma, about 0, of the hose's torque at rest; 0: there is none",
        unit="N m",
        check=NOT_NEGATIVE,
    )
    twist_deviation: float = setting(
        0.01,
        "1 sigma, about 0, of the hose's resistance to rotation; 0: there is none",
        unit="N m s",
        check=NOT_NEGATIVE,
    )
    drag_deviation: float = setting(
        0.05,
        "1 sigma, about 0, of the hose's resistance to translation; 0: there is none",
        unit="N s/m",
        check=NOT_NEGATIVE,
    )
    com_deviation: float = setting(
        0.01,
        "1 sigma of the center of mass of base and arm, each axis, if the description has none",
        unit="m",
        check=NOT_NEGATIVE,
    )
    mass_deviation: float = setting(
        0.05,
        "relative 1 sigma of mass and inertia of base and arm, if the description has none",
        check=NOT_NEGATIVE,
    )
    outlier: float = setting(
        3.0,
        "error of a drift predicted from the others above which it is an outlier",
        unit="deviations",
        check=POSITIVE,
    )
    min_time: float = setting(
        60.0, "total time of drifts needed to accept a result", unit="s", check=POSITIVE
    )
    max_tilt: float = setting(
        radians(0.001), "largest accepted deviation of the table's tilt", unit="rad", check=POSITIVE
    )
    max_torque: float = setting(
        1e-3, "largest accepted deviation of the hose's mean torque", unit="N m", check=POSITIVE
    )
