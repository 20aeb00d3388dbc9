"""Settings of a dynamic calibration; the same live, in a replay and offline."""

from dataclasses import dataclass, replace
from math import radians
from typing import ClassVar

from fss_arm_calib.dynamic.knowledge import Knowledge
from fss_arm_calib.segments.settings import ManeuverSettings, positive, sigma
from fss_arm_calib.settings import (
    CalibrationSettings,
    NoiseSettings,
    max_data,
    refuse_common_topic,
)
from fss_arm_model.choice import Choice
from fss_arm_model.description import paper_arm
from fss_arm_model.settings import NOT_NEGATIVE, SettingError, at_least, like, one_of, setting
from fss_arm_model.vehicle import Vehicle

POSE, HEADING = "pose", "heading"


@dataclass(frozen=True)
class DynamicSettings(ManeuverSettings, NoiseSettings, Knowledge):
    """Settings of a dynamic calibration: prior knowledge, estimated parameters and checks."""

    ABOUT: ClassVar = (
        "Masses, centers of mass and inertias, from the reaction of the base to maneuvers."
    )

    tip_topic: str = like(Vehicle, "tip_topic")
    gyro_topic: str = setting("fog/imu", "topic of the base's turn rates")
    max_maneuvers: int = max_data(100, "maneuvers")
    plan: str = setting(
        "",
        "plan of `design` for these maneuvers; the report compares its predicted deviations "
        "with the estimated ones",
    )
    estimate: str = setting(
        "b_i I_i I_0 com_0",
        "parameters to estimate: mass m, inertia I, center of mass b, length a, encoder offset "
        "theta_0 (b_2: of link 2, b_i: each, b: common to all); m_0 I_0 com_0: base; mount",
    )
    priors: str = setting(
        "m_i I_i m_0 I_0 com_0 a_i theta_0_i mount",
        "estimated parameters whose described values are priors, such as 'b_i I_0'",
    )
    residuals: str = setting(
        POSE,
        f"{POSE}: position and heading of the base; {HEADING}: heading only, as in the paper",
        check=one_of(POSE, HEADING),
    )
    fresh_rate: float = positive(
        10.0, "Hz", "poses per second that count as independent in an average"
    )
    path_timing: float = sigma(
        0.002, "s", "the timing of base poses in motion, relative to the joints"
    )
    momentum_deviation: float = sigma(
        1.0, "N s", "the momentum at the start of a maneuver (mean 0); 0: at rest"
    )
    spin_deviation: float = sigma(
        0.5, "N m s", "the angular momentum at the start of a maneuver (mean 0); 0: none"
    )
    tilt_deviation: float = sigma(
        radians(0.02), "rad", "the table's tilt, each axis, as by `drift` (mean 0); 0: level"
    )
    min_maneuvers: int = setting(
        6, "number of maneuvers needed to accept a result", check=at_least(1)
    )
    outlier: float = like(CalibrationSettings, "outlier", 3.0)
    min_redundancy: float = like(CalibrationSettings, "min_redundancy", 1e-3)
    max_tip_error: float = positive(
        0.03, "m", "largest accepted RMS error of the end effector's predicted position"
    )
    max_relative: float = setting(
        0.0,
        "largest accepted 1 sigma of a mass or inertia, relative to the described value; 0: any, "
        "also if not determined",
        check=NOT_NEGATIVE,
    )
    max_place: float = positive(
        0.02, "m", "largest accepted 1 sigma of a length or a center of mass"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_common_topic(self.base_topic, self.tip_topic)
        Choice.of(self.estimate, 12)
        arm = paper_arm()
        deviations = self.deviations(replace(arm, links=12 * arm.links[:1]))
        for word in self.estimate.split():
            if not (Choice.of(word, 12).basis.T @ deviations > 0.0).all():
                raise SettingError(
                    f"estimate has {word!r}, known exactly (its deviation is 0): remove it"
                )
        if self.priors.strip():
            Choice.of(self.priors, 12, "priors")
