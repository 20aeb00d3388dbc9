"""Parameters of the driver's nodes."""

from dataclasses import dataclass

from fss_arm_model.description import Arm, Link
from fss_arm_model.description_file import described
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, between, like, setting
from fss_arm_model.units import SECOND
from fss_arm_model.vehicle import Vehicle
from fss_link.protocol import load_key

PATH_RATE = 10.0  # rate of commands below which it is doubled on a path [1/s]


@dataclass(frozen=True)
class LinkSettings(Settings):
    """Parameters of a LinkNode."""

    link: int = setting(1, "number of the link; 1 is at the base", check=between(1, 255))
    url: str = setting(
        "",
        "address: udp://HOST:PORT, tcp://HOST:PORT, serial://DEVICE, or copley://DEVICE (a drive "
        "without a board); required unless urls is given",
    )
    urls: tuple[str, ...] = setting(
        (), "addresses of links 1, 2, ..., instead of url, to run all drivers in one process"
    )
    rate: float = setting(
        5.0,
        "rate at which the newest command is repeated; below 10 Hz it is doubled while the link "
        "follows a path that it has stored",
        unit="Hz",
        check=between(0.1, 1000.0),
    )
    max_rate: float = setting(
        50.0,
        "largest rate of commands to the link; up to it each command is sent when it arrives",
        unit="Hz",
        check=between(0.1, 1000.0),
    )
    timeout: float = setting(
        1.0,
        "silence after which the link is lost (while it follows a stored path: after 2 watchdog); "
        "also the longest round trip at which the link can be armed",
        unit="s",
        check=between(0.001, 3600.0),
    )
    watchdog: float = setting(
        2.0,
        "silence of the driver after which the link brakes, holds its joint under power and moves "
        "only after it is armed again",
        unit="s",
        check=between(0.001, 65.535),
    )
    empty: float = setting(
        12.0,
        "voltage of an empty battery, for the estimate of the minutes left; it switches nothing "
        "off",
        unit="V",
        check=NOT_NEGATIVE,
    )
    keys: str = setting("", "file of the links' keys; empty: frames are not signed")
    frame_prefix: str = like(Vehicle, "frame_prefix")
    arm: str = setting("", "arm: file or built in (paper, cad, truth); empty: paper")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rate * self.watchdog <= 1.0:
            raise ValueError(
                f"watchdog is {self.watchdog} s, expected more than the {1.0 / self.rate:g} s "
                f"from one command to the next (rate {self.rate})"
            )

    def command_period(self, on_path: bool) -> int:
        """Return the period of repeated commands [ns]."""
        period = round(SECOND / self.rate)
        return period // 2 if on_path and self.rate < PATH_RATE else period

    def link_description(self) -> Link:
        """Return the link's description from its arm's file.

        Raises:
            ValueError: the arm has no such link.
        """
        arm = described(self.arm)
        if self.link > arm.n:
            raise ValueError(f"link is {self.link}, expected 1 to {arm.n}, as arm {arm.name!r} has")
        return arm.links[self.link - 1]

    def key(self) -> bytes | None:
        """Return the key that signs the frames, if any.

        Raises:
            ValueError: keys are configured, but none for this link.
        """
        return load_key(self.keys, self.link, f"link {self.link}")


@dataclass(frozen=True)
class ArmSettings(GuardSettings):
    """Parameters of an ArmNode."""

    arm: str = setting("", "arm: file or built in (paper, cad, truth); empty: paper")
    rate: float = setting(
        5.0,
        "rate at which a motion's commands are sent, and the newest one is repeated",
        unit="Hz",
        check=between(0.1, 1000.0),
    )
    time_to_live: float = setting(
        1.0,
        "lifetime of commands to links; a motion also ends if a link is silent, or this node "
        "pauses, for longer",
        unit="s",
        check=between(0.001, 3600.0),
    )
    stream_time_to_live: float = setting(
        0.5,
        "age beyond which a message on arm/joint_commands is out of date",
        unit="s",
        check=between(0.001, 3600.0),
    )
    lead: float = setting(
        0.5,
        "least time from a trajectory's arrival to its start, so that the links receive it in time",
        unit="s",
        check=between(0.0, 60.0),
    )
    tolerance: float = setting(
        0.005, "a joint this close to its goal has reached it", unit="rad", check=POSITIVE
    )
    path_tolerance: float = setting(
        0.0,
        "largest error of a joint on a trajectory without path tolerances; 0: any",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    motion_threshold: float = setting(
        0.01, "rate above which a joint counts as moving", unit="rad/s", check=POSITIVE
    )
    max_overrun: float = setting(
        5.0,
        "time by which a move or a trajectory may exceed its planned duration",
        unit="s",
        check=POSITIVE,
    )
    state_rate: float = setting(
        20.0,
        "rate of arm/joint_states and of the transforms",
        unit="Hz",
        check=between(0.1, 1000.0),
    )
    max_extrapolation: float = setting(
        0.5,
        "age of a joint's measurement beyond which arm/joint_states is not published",
        unit="s",
        check=POSITIVE,
    )
    guard: bool = setting(
        True, "whether to reject motions that bring bodies closer to each other than the margins"
    )
    base_age: float = setting(
        1.0,
        "largest age of base/state or the target's pose; with an older one the guard does not "
        "check the edge or the target",
        unit="s",
        check=POSITIVE,
    )
    publish_tf: bool = setting(
        True, "whether to publish transforms; set it to false if robot_state_publisher runs"
    )
    full_tank: float = like(Vehicle, "full_tank")
    frame_prefix: str = like(Vehicle, "frame_prefix")
    target_topic: str = like(Vehicle, "target_topic")

    def description(self) -> Arm:
        """Return the description of the arm."""
        return described(self.arm)


@dataclass(frozen=True)
class DriverSettings(ArmSettings, LinkSettings):
    """Parameters of an ArmNode and its LinkNodes; common parameters are shared."""
