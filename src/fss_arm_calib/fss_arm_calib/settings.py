"""Settings that several kinds of calibration share."""

from dataclasses import dataclass
from math import radians

from fss_arm_calib.segments.settings import RestSettings, StreamSettings, positive, sigma
from fss_arm_model.estimation.least_squares import CAUCHY, HUBER, LOSSES, SQUARE
from fss_arm_model.settings import (
    NOT_NEGATIVE,
    Check,
    SettingError,
    at_least,
    like,
    one_of,
    setting,
)
from fss_arm_model.vehicle import Vehicle

FRACTION = Check("0 or more, and below 1", lambda value: 0.0 <= value < 1.0, low=0.0, high=1.0)


@dataclass(frozen=True)
class KindSettings(StreamSettings):
    """Settings of every calibration that finds its data in streams."""

    arm: str = setting("", "arm to start from: file or built in (paper, cad, truth); empty: paper")


@dataclass(frozen=True)
class CalibrationSettings(RestSettings, KindSettings):
    """Settings of calibrations that need rests: topics, and criteria that a result must meet."""

    joints_topic: str = setting("joint_states", "topic of the readings of joint_1 .. joint_n")
    base_topic: str = like(Vehicle, "base_topic")
    loss: str = setting(
        SQUARE,
        f"{SQUARE}, or {HUBER} or {CAUCHY}, which reduce the weight of outliers",
        check=one_of(*LOSSES),
    )
    min_probability: float = setting(
        1e-3, "smallest accepted chi-square probability of the residuals", check=FRACTION
    )
    outlier: float = positive(
        5.0,
        "",
        "residual, in standard deviations, above which a datum is an outlier; of maneuvers and "
        "drifts that of a prediction from the other data",
    )
    max_outliers: int = setting(
        0,
        "largest number of outliers to reject; with more, the calibration fails",
        check=NOT_NEGATIVE,
    )
    min_redundancy: float = setting(
        0.0,
        "smallest accepted redundancy of a datum (0: no other datum checks it, 1: fully checked); "
        "below it, record more data",
        check=FRACTION,
    )


@dataclass(frozen=True)
class NoiseSettings(CalibrationSettings):
    """Deviations of positions and headings that are given, or estimated from the residuals."""

    position_deviation: float = sigma(
        0.0, "m", "a measured position of the base, each axis; 0: estimated from the residuals"
    )
    heading_deviation: float = sigma(
        0.0, "rad", "a measured heading; 0: estimated from the residuals"
    )
    max_position_deviation: float = positive(
        0.001,
        "m",
        "largest accepted estimate of position_deviation; also used in place of an estimate if "
        "there are too few data",
    )
    max_heading_deviation: float = positive(
        radians(0.5),
        "rad",
        "largest accepted estimate of heading_deviation; also used in place of an estimate if "
        "there are too few data",
    )


def max_data(default: int, what: str) -> int:
    """Return a setting for the largest number of data in a result."""
    about = f"largest number of {what} in a result; the oldest are dropped"
    found: int = setting(default, about, check=at_least(1))
    return found


def refuse_common_topic(base_topic: str, tip_topic: str) -> None:
    """Raise SettingError if base and end effector have the same topic."""
    if base_topic == tip_topic:
        raise SettingError(f"base_topic and tip_topic are both {base_topic!r}, expected two topics")
