"""Settings that define a rest, a maneuver, a drift and an excitation."""

from dataclasses import dataclass

from fss_arm_model.settings import FINITE, NOT_NEGATIVE, POSITIVE, SettingError, Settings, setting


@dataclass(frozen=True)
class StreamSettings(Settings):
    """Settings for the gaps and lags of streams.

    Raises:
        SettingError: a setting is invalid.
    """

    joint_gap: float = setting(
        1.0, "silence of a joint that counts as a gap", unit="s", check=POSITIVE
    )
    horizon: float = setting(60.0, "how far streams may lag each other", unit="s", check=POSITIVE)


@dataclass(frozen=True)
class RestSettings(StreamSettings):
    """Settings that define a rest.

    Raises:
        SettingError: a setting is invalid.
    """

    motion_threshold: float = setting(
        1e-3, "largest change of a joint's reading at rest", unit="rad", check=POSITIVE
    )
    settle_time: float = setting(
        0.5, "time after the last motion that is not used", unit="s", check=NOT_NEGATIVE
    )
    min_duration: float = setting(0.5, "least time to average over", unit="s", check=POSITIVE)
    max_duration: float = setting(
        2.0, "time to average over if the arm rests that long", unit="s", check=POSITIVE
    )
    vicon_gap: float = setting(
        0.25, "silence of a VICON subject that counts as a gap", unit="s", check=POSITIVE
    )
    max_speed: float = setting(
        5.0, "a subject's pose that would need a faster motion is rejected", unit="m/s",
        check=POSITIVE,
    )  # fmt: skip
    max_turn: float = setting(
        10.0, "a subject's pose that would need a faster turn is rejected", unit="rad/s",
        check=POSITIVE,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_duration < self.min_duration:
            raise SettingError(
                f"max_duration is {self.max_duration} s, expected {self.min_duration} or more"
            )


@dataclass(frozen=True)
class ManeuverSettings(RestSettings):
    """Settings that define a maneuver.

    Raises:
        SettingError: a setting is invalid.
    """

    max_duration: float = setting(
        2.0, "longest window on the base before a maneuver, and after it; half a rest at most",
        unit="s", check=POSITIVE,
    )  # fmt: skip
    joint_gap: float = setting(
        0.5, "silence of a joint for which a maneuver is rejected", unit="s", check=POSITIVE
    )
    horizon: float = setting(
        60.0, "how far streams may lag each other, and how long a maneuver may last", unit="s",
        check=POSITIVE,
    )  # fmt: skip
    bin: float = setting(
        0.5, "time over which poses of a window are averaged", unit="s", check=POSITIVE
    )
    path_rate: float = setting(
        0.0, "poses of the base that count on its way, too, by joints that do not give; 0: none",
        unit="1/s", check=NOT_NEGATIVE,
    )  # fmt: skip
    min_travel: float = setting(0.05, "a smaller motion is no maneuver", unit="rad", check=POSITIVE)
    time_offset: float = setting(
        0.0,
        "about how much the joints' and the gyro's stamps are later than motion capture's, "
        "until the gyro's and the base's turns show it",
        unit="s", check=FINITE,
    )  # fmt: skip
    max_base_turn: float = setting(
        3.0, "largest rate of the base; what it may turn by unseen, the gyro must have seen",
        unit="rad/s", check=POSITIVE,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if not abs(self.time_offset) < self.horizon:
            raise SettingError(
                f"time_offset is {self.time_offset} s, expected within {self.horizon} s"
            )


@dataclass(frozen=True)
class DriftFinderSettings(RestSettings):
    """Settings that define a drift.

    Raises:
        SettingError: a setting is invalid.
    """

    min_duration: float = setting(
        20.0, "a shorter rest of the arm is no drift", unit="s", check=POSITIVE
    )
    max_duration: float = setting(
        120.0, "a longer rest of the arm is taken as several drifts", unit="s", check=POSITIVE
    )
    bin: float = setting(0.5, "time over which poses are averaged", unit="s", check=POSITIVE)


@dataclass(frozen=True)
class ExcitationSettings(StreamSettings):
    """Settings that define an excitation.

    Raises:
        SettingError: a setting is invalid.
    """

    joint_gap: float = setting(
        1.0, "silence of a link for which an excitation is rejected", unit="s", check=POSITIVE
    )
    min_speed: float = setting(0.01, "a slower joint stands still", unit="rad/s", check=POSITIVE)
