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
    """Settings of a dynamic calibration: prior knowledge, estimated parameters and checks.

    Raises:
        SettingError: a setting is impossible.
    """

    ABOUT: ClassVar = (
        "Masses, centres of mass and inertias, from how the base answers the arm's maneuvers."
    )

    tip_topic: str = like(Vehicle, "tip_topic")
    gyro_topic: str = setting("fog/imu", "topic of the base's turn rates")
    max_maneuvers: int = max_data(100, "maneuvers")
    plan: str = setting(
        "", "file of `design` by which the maneuvers were made: the report has what it promised"
    )
    estimate: str = setting(
        "b_i I_i I_0 com_0",
        "what to estimate, in words: b_i: of each link; I: one that all share; I_0 com_0 m_0: of "
        "the base; also m_i, a_i, theta_0_i, mount, or a name as b_2",
    )
    priors: str = setting(
        "m_i m_0 I_0 com_0 a_i theta_0_i mount",
        "words of `estimate` for which the description's value counts as an observation",
    )
    residuals: str = setting(
        POSE, f"{POSE}: the base's whole pose; {HEADING}: its heading alone, as the paper's",
        check=one_of(POSE, HEADING),
    )  # fmt: skip
    position_deviation: float = setting(
        0.0, "1 sigma of a position of the base, each axis; 0: estimated from the residuals",
        unit="m", check=NOT_NEGATIVE,
    )  # fmt: skip
    heading_deviation: float = setting(
        0.0, "1 sigma of a heading of the base; 0: estimated from the residuals", unit="rad",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    max_position_deviation: float = setting(
        0.001, "largest position_deviation that is believed of an estimate, and what a plan is "
        "made for", unit="m", check=POSITIVE,
    )  # fmt: skip
    max_heading_deviation: float = setting(
        radians(0.5), "largest heading_deviation that is believed of an estimate, and what a plan "
        "is made for", unit="rad", check=POSITIVE,
    )  # fmt: skip
    fresh_rate: float = setting(
        10.0,
        "rate of poses with independent errors, as averaging counts them",
        unit="1/s",
        check=POSITIVE,
    )
    path_timing: float = setting(
        0.002, "1 sigma of when the base is seen on its way, against the joints", unit="s",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    momentum_deviation: float = setting(
        1.0, "1 sigma, about 0, of the momentum at the start of a maneuver; 0: at rest",
        unit="N s", check=NOT_NEGATIVE,
    )  # fmt: skip
    spin_deviation: float = setting(
        0.5, "1 sigma, about 0, of the angular momentum at the start of a maneuver; 0: none",
        unit="N m s", check=NOT_NEGATIVE,
    )  # fmt: skip
    tilt_deviation: float = setting(
        radians(0.02), "1 sigma, about 0, of the table's tilt, each axis; 0: level", unit="rad",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    min_maneuvers: int = setting(6, "fewest maneuvers to accept a result from", check=at_least(1))
    outlier: float = setting(
        3.0, "error of a maneuver predicted from the others above which it is an outlier",
        unit="deviations", check=POSITIVE,
    )  # fmt: skip
    min_redundancy: float = setting(
        1e-3, "least share of a maneuver's error that the others let show, squared", check=FRACTION
    )
    max_tip_error: float = setting(
        0.03,
        "largest distance of the end effector from where the description puts it, root mean square",
        unit="m",
        check=POSITIVE,
    )
    max_relative: float = setting(
        1.0, "largest deviation of a mass or an inertia, of its value in the description",
        check=POSITIVE,
    )  # fmt: skip
    max_place: float = setting(
        0.02, "largest deviation of a length or a centre of mass", unit="m", check=POSITIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        Choice.of(self.estimate, 12)
        deviations = self.deviations(12)
        for word in self.estimate.split():
            if not (Choice.of(word, 12).basis.T @ deviations > 0.0).all():
                raise SettingError(
                    f"estimate has {word!r}, said to be known exactly (its deviation is 0): "
                    "leave it out"
                )
        if self.priors.strip():
            Choice.of(self.priors, 12, "priors")
