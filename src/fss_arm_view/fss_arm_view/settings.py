"""Parameters of the nodes of this package."""

import re
from dataclasses import dataclass
from ipaddress import ip_address

from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    Check,
    SettingError,
    Settings,
    at_least,
    between,
    like,
    one_of,
    setting,
)
from fss_arm_model.vehicle import Vehicle
from fss_gnc.navigation import SensorErrors


def _is_address(text: str) -> bool:
    try:
        return bool(ip_address(text))
    except ValueError:
        return False


ADDRESS = Check("an IP address (0.0.0.0: all)", _is_address)
PORT = between(1, 65535)
MEMORY = Check(
    "a size or a percentage, such as 100MB or 25%",
    lambda text: bool(re.fullmatch(r"\d+([kMGT]i?)?B|\d+%", text)),
)


@dataclass(frozen=True)
class ReactionSettings(SensorErrors):
    """Parameters of the base reaction: threshold of rest, differences, and the slope."""

    motion_threshold: float = setting(
        0.005, "joint rate above which a joint moves", unit="rad/s", check=POSITIVE
    )
    half_difference: float = setting(
        0.1,
        "half the interval of the differences that give joint accelerations",
        unit="s",
        check=POSITIVE,
    )
    tilt: tuple[float, ...] = setting(
        (0.0, 0.0),
        "tilt of the table; positive: it falls towards +x, +y",
        unit="rad",
        check=FINITE,
        size=2,
    )
    tilt_deviation: float = setting(
        0.0, "1 sigma of the tilt, each axis, as by `drift`", unit="rad", check=NOT_NEGATIVE
    )


@dataclass(frozen=True)
class BaseReactionSettings(ReactionSettings):
    """Parameters of a BaseReactionNode."""

    arm: str = setting(
        "",
        "arm until a calibration passes: file or built in (paper, cad, truth); empty: paper",
    )
    base_topic: str = like(Vehicle, "base_topic")
    world_frame: str = setting("world", "frame id of the published poses")
    base_frame: str = like(Vehicle, "base_frame")
    publish_state: bool = setting(
        True, "publish base/state and /tf; set it to false if navigation runs"
    )
    rate: float = setting(10.0, "rate of base_reaction", unit="Hz", check=between(1.0, 100.0))


@dataclass(frozen=True)
class ViewSettings(Settings):
    """Parameters of a ViewNode."""

    mode: str = setting(
        "web",
        "show in rerun's window, on a web page, in a recording, or in a running viewer",
        check=one_of("native", "web", "file", "connect"),
    )
    bind: str = setting(
        "127.0.0.1", "address that the page and its data are served on", check=ADDRESS
    )
    port: int = setting(9876, "port at which rerun receives data", check=PORT)
    web_port: int = setting(9090, "port of the page", check=PORT)
    names: tuple[str, ...] = setting((), "further host names under which the page may be opened")
    file: str = setting("view.rrd", "file of mode file; if it exists, NAME_1, NAME_2, ... is used")
    url: str = setting("rerun+http://127.0.0.1:9876/proxy", "address of the viewer in mode connect")
    memory: str = setting(
        "100MB",
        "memory limit of rerun; 100MB hold about 40 minutes; the oldest drawings are deleted first",
        check=MEMORY,
    )
    rate: float = setting(
        5.0,
        "maximum rate at which rerun draws each item; the page of web_port always draws at 10 Hz",
        unit="Hz",
        check=POSITIVE,
    )
    queue: int = setting(
        500,
        "maximum number of drawings that wait for the viewer; more are dropped",
        check=at_least(1),
    )
    arm: str = setting(
        "",
        "arm until a calibration passes: file or built in (paper, cad, truth); empty: paper",
    )
    base_topic: str = like(Vehicle, "base_topic")
    tip_topic: str = like(Vehicle, "tip_topic")
    target_topic: str = like(Vehicle, "target_topic")
    outline_topics: tuple[str, ...] = setting(
        ("workspace/markers", "workspace/straight_markers"), "marker topics whose lines are drawn"
    )
    base_frame: str = like(Vehicle, "base_frame")
    vehicles: tuple[str, ...] = setting(
        (), "namespaces of the vehicles to show; empty: only that of the node"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode == "file" and not self.file:
            raise SettingError("file is empty, expected the name of the recording: -p file:=NAME")
