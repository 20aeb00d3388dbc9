"""Settings of a kinematic calibration; the same live, in a replay and offline."""

from dataclasses import dataclass
from typing import ClassVar

from fss_arm_calib.kinematic.problem import (
    DESCRIBED,
    EQUAL,
    FULL,
    HEADING_DEVIATION,
    OFFSETS,
    PARAMETRIZATIONS,
    POSITION_DEVIATION,
)
from fss_arm_calib.segments.settings import positive, sigma
from fss_arm_calib.settings import (
    CalibrationSettings,
    NoiseSettings,
    max_data,
    refuse_common_topic,
)
from fss_arm_model.settings import Check, at_least, like, one_of, setting
from fss_arm_model.vehicle import Vehicle


@dataclass(frozen=True)
class KinematicSettings(NoiseSettings):
    """Settings of a kinematic calibration: estimated parameters and checks."""

    ABOUT: ClassVar = (
        "Lengths, joint offsets and the mount, from poses of the end effector while the arm rests."
    )

    tip_topic: str = like(Vehicle, "tip_topic")
    max_observations: int = max_data(200, "rests")
    parametrization: str = setting(
        DESCRIBED,
        f"{EQUAL}: one length for all links but the last; {FULL}: a length for each; {DESCRIBED}: "
        f"{EQUAL} if the described lengths are equal, else {FULL}; {OFFSETS}: only the angles, for "
        "use after a drive was switched off and on",
        check=one_of(DESCRIBED, *PARAMETRIZATIONS),
    )
    theta_e: bool = setting(False, "estimate the heading offset of the end effector's subject, too")
    position_deviation: float = sigma(
        0.0,
        "m",
        "the end effector's position seen from the base, each axis; 0: estimated. It contains the "
        "effect of the base's heading error, unless base_heading_deviation is given",
    )
    base_heading_deviation: float = sigma(
        0.0,
        "rad",
        "the base's heading, its square is a part of heading_deviation squared; 0: estimated "
        "if the deviations of position and heading are, else none",
    )
    max_position_deviation: float = like(
        NoiseSettings, "max_position_deviation", POSITION_DEVIATION
    )
    max_heading_deviation: float = like(NoiseSettings, "max_heading_deviation", HEADING_DEVIATION)
    ripple_deviation: float = sigma(
        0.0,
        "rad",
        "the encoder's error with two periods per turn of the motor; set it if poses are accurate "
        "to a millimeter",
    )
    eccentricity_deviation: float = sigma(
        0.0, "rad", "the encoder's error with one period per turn of the joint"
    )
    min_observations: int = setting(
        6, "number of observations needed to accept a result", check=at_least(1)
    )
    max_condition: float = setting(
        200.0,
        "largest condition number of the column-scaled regressor; above it, vary the postures",
        check=Check("more than 1", lambda value: value > 1.0, low=1.0),
    )
    min_redundancy: float = like(CalibrationSettings, "min_redundancy", 0.1)
    held_out: int = setting(
        4,
        "n: every n-th observation is held out and predicted from the others, if enough remain; "
        "0: none",
        check=Check("0, or 2 or more", lambda value: value == 0 or value >= 2, low=0.0),
    )
    max_length_change: float = positive(
        0.05, "m", "largest change of a described length; beyond, it seems to be another arm"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_common_topic(self.base_topic, self.tip_topic)
