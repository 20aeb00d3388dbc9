"""Settings that define a rest, a maneuver, a drift and an excitation."""

from dataclasses import dataclass

from fss_arm_model.settings import FINITE, NOT_NEGATIVE, POSITIVE, SettingError, Settings, setting


@dataclass(frozen=True)
class StreamSettings(Settings):
    """Settings for the gaps and lags of streams."""

    joint_gap: float = setting(
        1.0,
        "longest time without a reading of a joint; a longer one is a gap",
        unit="s",
        check=POSITIVE,
    )
    horizon: float = setting(
        60.0, "largest lag of a stream behind the others", unit="s", check=POSITIVE
    )


@dataclass(frozen=True)
class RestSettings(StreamSettings):
    """Settings that define a rest."""

    motion_threshold: float = setting(
        1e-3, "largest change of a joint's reading at rest", unit="rad", check=POSITIVE
    )
    settle_time: float = setting(
        0.5, "time after the last motion that is discarded", unit="s", check=NOT_NEGATIVE
    )
    min_duration: float = setting(0.5, "shortest averaging time", unit="s", check=POSITIVE)
    max_duration: float = setting(2.0, "longest averaging time", unit="s", check=POSITIVE)
    vicon_gap: float = setting(
        0.25,
        "longest time without a pose of a VICON subject; a longer one is a gap",
        unit="s",
        check=POSITIVE,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_duration < self.min_duration:
            raise SettingError(
                f"max_duration is {self.max_duration} s, expected {self.min_duration} or more"
            )


@dataclass(frozen=True)
class ManeuverSettings(RestSettings):
    """Settings that define a maneuver."""

    max_duration: float = setting(
        2.0,
        "longest window before and after a maneuver, at most half of the rest",
        unit="s",
        check=POSITIVE,
    )
    joint_gap: float = setting(
        0.5,
        "longest time without a reading of a joint; a longer one rejects a maneuver",
        unit="s",
        check=POSITIVE,
    )
    horizon: float = setting(
        60.0,
        "largest lag of a stream behind the others, and longest duration of a maneuver",
        unit="s",
        check=POSITIVE,
    )
    bin: float = setting(0.5, "averaging time of the poses in a window", unit="s", check=POSITIVE)
    path_rate: float = setting(
        0.0,
        "rate of base poses used during the motion, for stiff joints only; 0: none",
        unit="Hz",
        check=NOT_NEGATIVE,
    )
    time_offset: float = setting(
        0.0,
        "initial estimate of the offset of the joints' and the gyro's stamps relative to motion "
        "capture's; the rotation of the base then refines it",
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

    min_duration: float = setting(
        20.0, "shortest rest of the arm that is a drift", unit="s", check=POSITIVE
    )
    max_duration: float = setting(
        120.0,
        "longest drift; a longer rest of the arm is split into several drifts",
        unit="s",
        check=POSITIVE,
    )
    bin: float = setting(0.5, "averaging time of the poses", unit="s", check=POSITIVE)


@dataclass(frozen=True)
class ExcitationSettings(StreamSettings):
    """Settings that define an excitation."""

    joint_gap: float = setting(
        1.0,
        "longest time without a frame of a link; a longer one rejects an excitation",
        unit="s",
        check=POSITIVE,
    )
    min_speed: float = setting(
        0.01, "speed below which a joint is at rest", unit="rad/s", check=POSITIVE
    )
