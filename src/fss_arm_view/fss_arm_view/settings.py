"""The parameters of the nodes of this package."""

from dataclasses import dataclass
from ipaddress import ip_address

from fss_arm_model.settings import setting


@dataclass(frozen=True)
class SensorErrors:
    """What the base's sensors err by, and how it may accelerate; all 1 sigma."""

    position_error: float = setting(0.001, "of a VICON pose of the base, each axis [m]")
    heading_error: float = setting(0.009, "likewise [rad]")
    rate_error: float = setting(0.001, "of a gyro sample [rad/s]")
    bias_walk: float = setting(1e-5, "of the gyro's bias within 1 s [rad/s]")
    acceleration: float = setting(0.05, "of the base, as change of velocity within 1 s [m/s]")
    angular_acceleration: float = setting(0.3, "likewise [rad/s]")


@dataclass(frozen=True)
class ReactionSettings(SensorErrors):
    """When the arm rests, and over what times its base is judged."""

    still: float = setting(0.005, "joint rate below which a joint rests [rad/s]")
    longest_drift: float = setting(2.0, "before a motion that a prediction begins from [s]")
    shortest_drift: float = setting(0.5, "likewise [s]")
    half_difference: float = setting(
        0.1, "half the time that accelerations are differences over [s]"
    )
    drift_window: float = setting(30.0, "time that the slope of the momentum is taken over [s]")
    tilt: tuple[float, ...] = setting((0.0, 0.0), "of the table along x and y, downhill [rad]")
    tilt_deviation: float = setting(0.0, "of each, 1 sigma; `drift` tells both [rad]")

    def __post_init__(self) -> None:
        if len(self.tilt) != 2:
            raise ValueError(f"tilt has {len(self.tilt)} numbers, expected 2")
        if not self.tilt_deviation >= 0.0:
            raise ValueError(f"tilt_deviation is {self.tilt_deviation}, expected 0 or more")
        for name, value in vars(self).items():
            if isinstance(value, float) and name != "tilt_deviation" and not value > 0.0:
                raise ValueError(f"{name} is {value}, expected more than 0")


@dataclass(frozen=True)
class BaseReactionSettings(ReactionSettings):
    """The parameters of a BaseReactionNode."""

    arm: str = setting("", "file of the description to begin with; empty: the paper's arm")
    joints_topic: str = setting("joint_states", "of the joints' readings")
    base_topic: str = setting("vicon/fss/fss", "of the base's poses")
    gyro_topic: str = setting("fog/imu", "of the base's rate")
    world_frame: str = setting("world", "frame id of what is published")
    base_frame: str = setting("fss", "child frame id of base/state and /tf")
    rate: float = setting(10.0, "of base_reaction [1/s]")


@dataclass(frozen=True)
class ViewSettings:
    """The parameters of a ViewNode."""

    mode: str = setting("web", "native: a window; web: a page; file; connect: to a viewer")
    bind: str = setting("127.0.0.1", "IP address that the page and its data are served on")
    port: int = setting(9876, "of the data that the viewer listens to")
    web_port: int = setting(9090, "of the page")
    file: str = setting("view.rrd", "that mode file writes; if there, NAME_1, NAME_2, ...")
    url: str = setting("rerun+http://127.0.0.1:9876/proxy", "of the viewer of mode connect")
    memory: str = setting("1GB", "that the viewer keeps; the oldest goes first")
    rate: float = setting(10.0, "most often that one thing is drawn [1/s]")
    queue: int = setting(500, "drawings that may wait for the viewer; more are dropped")
    arm: str = setting("", "file of the description to begin with; empty: the paper's arm")
    joints_topic: str = setting("joint_states", "of the joints' readings")
    base_topic: str = setting("vicon/fss/fss", "of the base's poses")
    tip_topic: str = setting("vicon/end_effector/end_effector", "of the end effector's poses")
    target_topic: str = setting("vicon/target/target", "of a target's poses")
    outline_topics: tuple[str, ...] = setting(
        ("workspace/markers", "workspace/straight_markers"), "of markers whose lines are drawn"
    )
    base_frame: str = setting("fss", "frame id of lines that move with the base")

    def __post_init__(self) -> None:
        if self.mode not in ("native", "web", "file", "connect"):
            raise ValueError(
                f"mode is {self.mode!r}, expected 'native', 'web', 'file' or 'connect'"
            )
        if self.mode == "file" and not self.file:
            raise ValueError("file is empty, expected the name of the recording: -p file:=NAME")
        try:
            ip_address(self.bind)
        except ValueError:
            raise ValueError(
                f"bind is {self.bind!r}, expected an IP address as 127.0.0.1; 0.0.0.0 for all"
            ) from None
        if not self.rate > 0.0:
            raise ValueError(f"rate is {self.rate}, expected more than 0")
        if self.queue < 1:
            raise ValueError(f"queue is {self.queue}, expected 1 or more")
