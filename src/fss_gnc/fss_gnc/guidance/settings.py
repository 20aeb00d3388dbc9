"""Parameters of the base's motion by the node `guidance`."""

from dataclasses import dataclass

from fss_arm_model.extents import Extents
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, between, like, setting


@dataclass(frozen=True)
class GuidanceSettings(Extents):
    """Parameters of a GuidanceNode, without those of the missions."""

    arm: str = setting("", "arm to begin with: paper, cad, truth or a file; empty: paper")
    rate: float = setting(
        10.0, "rate of the guidance, at which base/trajectory is repeated", unit="1/s",
        check=between(1.0, 100.0),
    )  # fmt: skip
    horizon: float = setting(
        2.0, "time ahead that each base/trajectory tells of", unit="s", check=between(1.0, 60.0)
    )
    max_age: float = setting(
        0.5, "age of base/state or arm/joint_states at which what goes on is aborted", unit="s",
        check=POSITIVE,
    )  # fmt: skip
    speed: float = setting(0.06, "most speed of the base", unit="m/s", check=POSITIVE)
    acceleration: float = setting(
        0.003, "most acceleration of the base", unit="m/s^2", check=POSITIVE
    )
    turn_rate: float = setting(0.1, "most turn rate of the base", unit="rad/s", check=POSITIVE)
    turn_acceleration: float = setting(
        0.003, "most angular acceleration of the base", unit="rad/s^2", check=POSITIVE
    )
    tolerance: float = setting(
        0.02, "distance from a goal at which the base has reached it", unit="m", check=POSITIVE
    )
    heading_tolerance: float = setting(
        0.03, "turn away from a goal at which the base has reached it", unit="rad", check=POSITIVE
    )
    still: float = setting(
        0.005, "speed at which a base that is at its goal has reached it", unit="m/s",
        check=POSITIVE,
    )  # fmt: skip
    turning_still: float = setting(
        0.01, "turn rate at which a base that is at its goal has reached it", unit="rad/s",
        check=POSITIVE,
    )  # fmt: skip
    max_overrun: float = setting(
        30.0, "most time beyond the planned one to reach a goal", unit="s", check=POSITIVE
    )
    max_offset: float = setting(
        0.15, "farthest that the base may be from its reference, else what goes on is aborted",
        unit="m", check=POSITIVE,
    )  # fmt: skip
    max_turn: float = setting(
        0.35, "most that the base may be turned from its reference, else what goes on is aborted",
        unit="rad", check=POSITIVE,
    )  # fmt: skip
    keep_out: float = setting(
        0.3, "radius about the target's origin that base, arm and gripper stay out of", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    edge_margin: float = like(GuardSettings, "edge_margin")
    target_radius: float = like(GuardSettings, "target_radius")
    gripper_length: float = like(GuardSettings, "gripper_length")
