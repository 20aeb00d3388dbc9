"""Settings that define a rest, a maneuver, a drift and an excitation."""

from dataclasses import dataclass
from typing import Any

from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    like,
    setting,
)


def positive(default: float, unit: str, about: str) -> Any:
    """Create a setting for a positive quantity."""
    return setting(default, about, unit=unit, check=POSITIVE)


def sigma(default: float, unit: str, what: str) -> Any:
    """Create a setting for the standard deviation of `what`, 0 or more."""
    return setting(default, f"1 sigma of {what}", unit=unit, check=NOT_NEGATIVE)


@dataclass(frozen=True)
class StreamSettings(Settings):
    """Settings for the gaps and lags of streams."""

    joint_gap: float = positive(
        1.0,
        "s",
        "longest gap in joint samples, or backward jump of a clock; a datum with more is rejected",
    )
    horizon: float = positive(60.0, "s", "longest wait for a stream that lags behind the others")


@dataclass(frozen=True)
class RestSettings(StreamSettings):
    """Settings that define a rest."""

    motion_threshold: float = positive(1e-3, "rad", "largest change of a joint's reading at rest")
    settle_time: float = setting(
        0.5, "time after the last motion that is discarded", unit="s", check=NOT_NEGATIVE
    )
    min_duration: float = positive(0.5, "s", "shortest averaging time")
    max_duration: float = positive(2.0, "s", "longest averaging time")
    vicon_gap: float = positive(
        0.25, "s", "time without a pose of a VICON subject beyond which the datum is rejected"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_duration < self.min_duration:
            raise SettingError(
                f"max_duration is {self.max_duration} s, expected {self.min_duration} or more"
            )


@dataclass(frozen=True)
class ManeuverSettings(RestSettings):
    """Settings that define a maneuver; a gap rejects it."""

    max_duration: float = positive(
        2.0, "s", "longest averaging before and after a maneuver, at most half of the pause"
    )
    joint_gap: float = like(StreamSettings, "joint_gap", 0.5)
    horizon: float = positive(
        60.0, "s", "longest wait for a stream that lags, and longest duration of a maneuver"
    )
    bin: float = positive(0.5, "s", "averaging time of the poses in a window")
    path_rate: float = setting(
        0.0,
        "rate of poses of the moving base that are used, too; only for rigid gears; 0: none",
        unit="Hz",
        check=NOT_NEGATIVE,
    )
    time_offset: float = setting(
        0.0,
        "first estimate of the stamps of joints and gyro minus those of motion capture; "
        "refined from the base's rotation",
        unit="s",
        check=FINITE,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not abs(self.time_offset) < self.horizon:
            raise SettingError(
                f"time_offset is {self.time_offset} s, expected within {self.horizon} s"
            )


@dataclass(frozen=True)
class DriftFinderSettings(RestSettings):
    """Settings that define a drift."""

    min_duration: float = positive(20.0, "s", "shortest rest of the arm that is a drift")
    max_duration: float = positive(
        120.0, "s", "longest drift; a longer rest of the arm is split into several drifts"
    )
    bin: float = positive(0.5, "s", "averaging time of the poses")


@dataclass(frozen=True)
class ExcitationSettings(StreamSettings):
    """Settings that define an excitation; a gap in the frames of a link rejects it."""

    min_speed: float = positive(0.01, "rad/s", "speed below which a joint is at rest")
