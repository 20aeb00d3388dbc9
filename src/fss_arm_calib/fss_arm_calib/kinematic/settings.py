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
from fss_arm_calib.settings import FRACTION, CalibrationSettings, max_data
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Check, at_least, like, one_of, setting
from fss_arm_model.vehicle import Vehicle


@dataclass(frozen=True)
class KinematicSettings(CalibrationSettings):
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
    position_deviation: float = setting(
        0.0,
        "1 sigma of a position relative to the base, each axis, including the error of the base's "
        "heading times the reach; 0: estimated from the residuals",
        unit="m",
        check=NOT_NEGATIVE,
    )
    heading_deviation: float = setting(
        0.0,
        "1 sigma of an observed heading; 0: estimated from the residuals",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    max_position_deviation: float = setting(
        POSITION_DEVIATION,
        "largest accepted estimate of position_deviation; assumed with too few observations",
        unit="m",
        check=POSITIVE,
    )
    max_heading_deviation: float = setting(
        HEADING_DEVIATION,
        "largest accepted estimate of heading_deviation; assumed with too few observations",
        unit="rad",
        check=POSITIVE,
    )
    ripple_deviation: float = setting(
        0.0,
        "1 sigma of the reading error with two periods per turn of the wave generator; it "
        "dominates if poses are accurate to a millimeter",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    eccentricity_deviation: float = setting(
        0.0,
        "1 sigma of the reading error with one period per turn of the joint",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    min_observations: int = setting(
        6, "number of observations needed to accept a result", check=at_least(1)
    )
    max_condition: float = setting(
        200.0,
        "largest condition number of the column-scaled regressor",
        check=Check("more than 1", lambda value: value > 1.0, low=1.0),
    )
    min_redundancy: float = setting(
        0.1,
        "smallest redundancy: squared share of an observation's error that its residual shows",
        check=FRACTION,
    )
    held_out: int = setting(
        4,
        "every n-th observation is held out and predicted from the others, if enough remain; "
        "0: none",
        check=Check("0, or 2 or more", lambda value: value == 0 or value >= 2, low=0.0),
    )
    max_length_change: float = setting(
        0.05,
        "largest change of a link's length; a larger one means another arm",
        unit="m",
        check=POSITIVE,
    )
