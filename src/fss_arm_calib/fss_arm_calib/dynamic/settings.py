"""Settings of a dynamic calibration; the same live, in a replay and offline."""

from dataclasses import dataclass
from math import radians
from typing import ClassVar

from fss_arm_calib.dynamic.parameters import Choice, Knowledge
from fss_arm_calib.segments.settings import ManeuverSettings
from fss_arm_calib.settings import FRACTION, CalibrationSettings, max_data
from fss_arm_model.settings import (
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    at_least,
    like,
    one_of,
    setting,
)
from fss_arm_model.vehicle import Vehicle

POSE, HEADING = "pose", "heading"


@dataclass(frozen=True)
class DynamicSettings(ManeuverSettings, CalibrationSettings, Knowledge):
    """Settings of a dynamic calibration: prior knowledge, estimated parameters and checks."""

    ABOUT: ClassVar = (
        "Masses, centers of mass and inertias, from the reaction of the base to maneuvers."
    )

    tip_topic: str = like(Vehicle, "tip_topic")
    gyro_topic: str = setting("fog/imu", "topic of the base's turn rates")
    max_maneuvers: int = max_data(100, "maneuvers")
    plan: str = setting(
        "", "plan of `design` for these maneuvers; the report compares its promised deviations"
    )
    estimate: str = setting(
        "b_i I_i I_0 com_0",
        "parameters to estimate: b_i: of each link; I: one value that all links share; I_0 com_0 "
        "m_0: of the base; also m_i, a_i, theta_0_i, mount, or a name such as b_2",
    )
    priors: str = setting(
        "m_i m_0 I_0 com_0 a_i theta_0_i mount",
        "words of `estimate` for which the description's value counts as an observation",
    )
    residuals: str = setting(
        POSE,
        f"{POSE}: position and heading of the base; {HEADING}: heading only, as in the paper",
        check=one_of(POSE, HEADING),
    )
    position_deviation: float = setting(
        0.0,
        "1 sigma of a position of the base, each axis; 0: estimated from the residuals",
        unit="m",
        check=NOT_NEGATIVE,
    )
    heading_deviation: float = setting(
        0.0,
        "1 sigma of a heading of the base; 0: estimated from the residuals",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    max_position_deviation: float = setting(
        0.001,
        "largest accepted estimate of position_deviation; also assumed for a plan",
        unit="m",
        check=POSITIVE,
    )
    max_heading_deviation: float = setting(
        radians(0.5),
        "largest accepted estimate of heading_deviation; also assumed for a plan",
        unit="rad",
        check=POSITIVE,
    )
    fresh_rate: float = setting(
        10.0,
        "rate of poses with independent errors, for the deviation of averages",
        unit="Hz",
        check=POSITIVE,
    )
    path_timing: float = setting(
        0.002,
        "1 sigma of the timing of base poses in motion, relative to the joints",
        unit="s",
        check=NOT_NEGATIVE,
    )
    momentum_deviation: float = setting(
        1.0,
        "1 sigma, about 0, of the momentum at the start of a maneuver; 0: at rest",
        unit="N s",
        check=NOT_NEGATIVE,
    )
    spin_deviation: float = setting(
        0.5,
        "1 sigma, about 0, of the angular momentum at the start of a maneuver; 0: none",
        unit="N m s",
        check=NOT_NEGATIVE,
    )
    tilt_deviation: float = setting(
        radians(0.02),
        "1 sigma, about 0, of the table's tilt, each axis; 0: level",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    min_maneuvers: int = setting(
        6, "number of maneuvers needed to accept a result", check=at_least(1)
    )
    outlier: float = setting(
        3.0,
        "error of a maneuver predicted from the others above which it is an outlier",
        unit="deviations",
        check=POSITIVE,
    )
    min_redundancy: float = setting(
        1e-3,
        "smallest redundancy: squared share of a maneuver's error that its residual shows",
        check=FRACTION,
    )
    max_tip_error: float = setting(
        0.03,
        "largest distance of the end effector from its described position, root mean square",
        unit="m",
        check=POSITIVE,
    )
    max_relative: float = setting(
        1.0,
        "largest deviation of a mass or an inertia, relative to the described value",
        check=POSITIVE,
    )
    max_place: float = setting(
        0.02, "largest deviation of a length or a center of mass", unit="m", check=POSITIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        Choice.of(self.estimate, 12)
        deviations = self.deviations(12)
        for word in self.estimate.split():
            if not (Choice.of(word, 12).basis.T @ deviations > 0.0).all():
                raise SettingError(
                    f"estimate has {word!r}, known exactly (its deviation is 0): remove it"
                )
        if self.priors.strip():
            Choice.of(self.priors, 12, "priors")
