"""Parameters of the base's nodes."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    between,
    like,
    one_of,
    setting,
)
from fss_arm_model.thrusters import thruster_wrenches
from fss_arm_model.vehicle import Vehicle
from fss_base_driver.dsp3000 import BAUD
from fss_base_driver.protocol import BOARD, VALVES
from fss_link.protocol import load_key

MAX_OVERLOAD = 1000.0  # largest component of a wrench, as multiple of the total thrust
SYSTEMS = ("vicon", "vrpn", "optitrack", "qualisys", "mock")


@dataclass(frozen=True)
class MocapSettings(Settings):
    """Parameters of a MocapNode."""

    system: str = setting(
        "",
        "motion-capture system to receive from; empty: none, only relays",
        check=one_of("", *SYSTEMS),
    )
    host: str = setting(
        "", "address of the motion-capture system's computer; required except for mock"
    )
    options: tuple[str, ...] = setting((), "further options of libmotioncapture, each OPTION=VALUE")
    relays: tuple[str, ...] = setting(
        (),
        "topics of other receivers to relay, each SUBJECT=TOPIC, or TOPIC if its messages name "
        "the subjects",
    )
    relay_scale: float = setting(
        1.0, "length unit of the relayed topics; 0.001 for millimetres", unit="m", check=POSITIVE
    )
    subjects: tuple[str, ...] = setting(
        (),
        "bodies to publish: NAME in the system, or NAME=SUBJECT/SEGMENT for another topic; "
        "empty: all",
    )
    prefix: str = setting(
        "vicon", "first part of the topics PREFIX/SUBJECT/SEGMENT", within="/vicon"
    )
    frame_id: str = setting("world", "frame of the poses")
    latency: float = setting(
        0.0,
        "delay from exposure to arrival, subtracted from the time of arrival",
        unit="s",
        check=between(0.0, 10.0),
    )
    max_speed: float = setting(
        1.0, "speed above which a subject has jumped", unit="m/s", check=POSITIVE
    )
    max_turn: float = setting(
        3.0, "rate of turn above which a subject has jumped", unit="rad/s", check=POSITIVE
    )
    settle_time: float = setting(
        1.0,
        "time of plausible motion after which a subject that jumped is accepted again",
        unit="s",
        check=POSITIVE,
    )
    timeout: float = setting(
        1.0,
        "silence after which the system or a subject is reported as missing",
        unit="s",
        check=POSITIVE,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.system and not self.relays:
            raise SettingError(
                f"no source of poses: set system (one of {', '.join(SYSTEMS)}) or relays (topics)"
            )
        if self.system not in ("", "mock") and not self.host:
            raise SettingError(f"host is '', expected the address of the {self.system} computer")
        for option in self.options:
            if "=" not in option:
                raise SettingError(f"options holds {option!r}, expected OPTION=VALUE")

    def source(self) -> str:
        """Return the source of the poses, in words."""
        return " at ".join(filter(None, (self.system, self.host))) or ", ".join(self.relays)

    def places(self) -> dict[str, str]:
        """Return the topic after the prefix for each named subject; empty if all are wanted."""
        pairs = (subject.partition("=")[::2] for subject in self.subjects)
        return {name: place or f"{name}/{name}" for name, place in pairs}


@dataclass(frozen=True)
class BaseSettings(Settings):
    """Parameters of a BaseNode."""

    url: str = setting("", "address of the base's board: udp://, tcp:// or serial://; required")
    rate: float = setting(
        20.0,
        "rate at which the newest command is repeated",
        unit="Hz",
        check=between(1.0, 1000.0),
    )
    max_rate: float = setting(
        50.0,
        "largest rate of commands to the board; up to it each command is sent when it arrives",
        unit="Hz",
        check=between(1.0, 1000.0),
    )
    timeout: float = setting(
        1.0,
        "silence after which the board is reported as lost, and longest round trip to arm it",
        unit="s",
        check=between(0.001, 3600.0),
    )
    watchdog: float = setting(
        0.5,
        "silence of the driver after which the board disarms itself and closes its valves",
        unit="s",
        check=between(0.001, 65.535),
    )
    empty: float = setting(
        12.0,
        "voltage of an empty battery, for the minutes left; it switches nothing off",
        unit="V",
        check=NOT_NEGATIVE,
    )
    keys: str = setting(
        "", "file of keys, in which the board has number 0; empty: frames are not signed"
    )
    base_frame: str = like(Vehicle, "base_frame")
    frame_prefix: str = like(Vehicle, "frame_prefix")
    thrust: float = setting(0.16, "thrust of one of the thrusters", unit="N", check=POSITIVE)
    lever: float = setting(
        0.11,
        "lever of a thruster: from the base's origin to the line of thrust; same value as "
        "thruster_lever of `navigation`",
        unit="m",
        check=POSITIVE,
    )
    layout: tuple[float, ...] = setting(
        (),
        "instead of thrust and lever: for each valve, force along x and y and torque about "
        "the base's origin, 24 numbers",
        unit="N, N, N m",
        check=FINITE,
    )
    minimum_on_time: float = setting(
        0.01,
        "shortest pulse for a wrench; a shorter one is added to the next",
        unit="s",
        check=NOT_NEGATIVE,
    )
    max_on_time: float = setting(
        1.0,
        "longest on-time that is accepted on thrusters/command; the board cuts pulses at 1 s",
        unit="s",
        check=between(0.001, 6.5),
    )
    command_lifetime: float = setting(
        0.5,
        "age beyond which a message on thrusters/command is refused",
        unit="s",
        check=between(0.001, 10.0),
    )
    wrench_lifetime: float = setting(
        0.3,
        "age beyond which a message on base/wrench has no effect",
        unit="s",
        check=between(0.001, 10.0),
    )
    wrench_period: float = setting(
        0.1,
        "period over which a wrench is averaged, with one pulse of each valve",
        unit="s",
        check=between(0.02, 1.0),
    )
    gyro_noise: float = setting(
        1.75e-4, "white noise of a gyro sample, 1 sigma", unit="rad/s", check=NOT_NEGATIVE
    )
    bias_time: float = setting(
        10.0, "time over which base/find_gyro_bias averages", unit="s", check=between(0.1, 3600.0)
    )
    bias_scatter: float = setting(
        0.001,
        "standard deviation of the rates above which base/find_gyro_bias fails",
        unit="rad/s",
        check=POSITIVE,
    )
    max_bias: float = setting(
        0.01,
        "mean rate above which base/find_gyro_bias fails, because the base evidently turns",
        unit="rad/s",
        check=POSITIVE,
    )
    tank_volume: float = setting(0.43e-3, "volume of the gas tank", unit="m^3", check=POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rate * self.watchdog <= 1.0:
            raise SettingError(
                f"watchdog is {self.watchdog} s, expected more than the {1.0 / self.rate:g} s "
                f"from one command to the next (rate {self.rate})"
            )
        if len(self.layout) not in (0, 3 * VALVES):
            raise SettingError(f"layout has {len(self.layout)} numbers, expected {3 * VALVES}")
        if self.minimum_on_time >= self.wrench_period:
            raise SettingError(
                f"minimum_on_time is {self.minimum_on_time} s, expected below wrench_period, "
                f"{self.wrench_period} s"
            )
        if self.max_on_time < self.wrench_period:  # otherwise no large wrench would be accepted
            raise SettingError(
                f"max_on_time is {self.max_on_time} s, expected at least wrench_period, "
                f"{self.wrench_period} s"
            )

    def valves(self) -> npt.NDArray[np.float64]:
        """Return force along x and y [N] and torque [N m] of each valve, (8, 3)."""
        if self.layout:
            return np.reshape(self.layout, (VALVES, 3))
        return thruster_wrenches(self.thrust, self.lever)

    def max_wrench(self) -> float:
        """Return the largest accepted component of a wrench [N, N m]."""
        return MAX_OVERLOAD * float(np.hypot(*self.valves()[:, :2].T).sum())

    def key(self) -> bytes | None:
        """Return the key for the signatures of frames, if any.

        Raises:
            ValueError: keys are configured, but none for the board.
        """
        return load_key(self.keys, BOARD, f"the board, {BOARD}")


@dataclass(frozen=True)
class ValveSettings(Settings):
    """Parameters of a valve that can change at runtime; a stuck valve gets no share of a wrench."""

    stuck_open: float = setting(
        0.0,
        "0: sound; more: stuck open, and others compensate it",
        check=between(0.0, 1.0),
    )
    stuck_closed: float = setting(
        0.0, "0: sound; more: stuck closed; it is not used", check=between(0.0, 1.0)
    )


@dataclass(frozen=True)
class GyroSettings(Settings):
    """Parameters of the gyro that can change at runtime."""

    scale: float = setting(
        1e-6, "rate of turn of one count; may be negative", unit="rad/s", check=FINITE
    )
    bias: float = setting(0.0, "rate that the gyro reports at rest", unit="rad/s", check=FINITE)


def live_kinds() -> dict[str, type]:
    """Return the parameters of a BaseNode that can change at runtime, by prefix."""
    return {**{f"valve_{i}": ValveSettings for i in range(1, VALVES + 1)}, "gyro": GyroSettings}


@dataclass(frozen=True)
class FogSettings(Settings):
    """Parameters of a FogNode."""

    device: str = setting("/dev/ttyUSB0", "serial port of the gyro")
    baud: int = setting(
        BAUD, "bit rate of the serial port", unit="bit/s", check=between(300, 4_000_000)
    )
    base_frame: str = like(BaseSettings, "base_frame")
    gyro_noise: float = like(BaseSettings, "gyro_noise")
    latency: float = setting(
        0.009,
        "time from the middle of a rate's averaging to the end of its serial message",
        unit="s",
        check=between(0.0, 10.0),
    )


@dataclass(frozen=True)
class FogCorrection(Settings):
    """Correction of the gyro's rates that can change at runtime."""

    scale: float = setting(
        1.0, "factor of its rates; -1 if the gyro is mounted upside down", check=FINITE
    )
    bias: float = setting(0.0, "rate at rest, scaled, subtracted", unit="rad/s", check=FINITE)


def live_fog_kinds() -> dict[str, type]:
    """Return the parameters of a FogNode that can change at runtime, by prefix."""
    return {"gyro": FogCorrection}
