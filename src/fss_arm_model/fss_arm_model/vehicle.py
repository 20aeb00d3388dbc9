"""Topics and frames that distinguish vehicles: motion-capture subjects and frame ids.

A laboratory has one motion-capture receiver and one /tf. Without a namespace the vehicle is `fss`;
in a namespace /fss2 its subjects and frames are named after the namespace.
"""

from dataclasses import dataclass

from .settings import NOT_NEGATIVE, Settings, setting


@dataclass(frozen=True)
class Vehicle(Settings):
    """Settings that a vehicle's nodes share, see `like`."""

    base_topic: str = setting(
        "vicon/fss/fss", "topic of the base's poses", within="/vicon/{vehicle}/{vehicle}"
    )
    tip_topic: str = setting(
        "vicon/end_effector/end_effector",
        "topic of the end effector's poses",
        within="/vicon/{vehicle}_end_effector/{vehicle}_end_effector",
    )
    target_topic: str = setting(
        "vicon/target/target", "topic of the target's poses", within="/vicon/target/target"
    )
    base_frame: str = setting(
        "fss", "frame id of the base, and of data relative to it", within="{namespace}/fss"
    )
    frame_prefix: str = setting(
        "", "prefix of the vehicle's frame ids, as in robot_state_publisher", within="{namespace}/"
    )
    full_tank: float = setting(
        0.1,
        "propellant that the described mass of the base includes",
        unit="kg",
        check=NOT_NEGATIVE,
    )
