"""Parameters of the base's motion by the node `guidance`."""

from dataclasses import dataclass

from fss_arm_model.extents import Extents
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, between, like, setting


@dataclass(frozen=True)
class GuidanceSettings(Extents):
    """Parameters of a GuidanceNode, without those of the missions."""

    arm: str = setting(
        "",
        "arm: file or built in (paper, cad, truth); empty: paper; calibrations are ignored",
    )
    rate: float = setting(
        10.0,
        "rate at which base/trajectory is computed and published",
        unit="Hz",
        check=between(1.0, 100.0),
    )
    horizon: float = setting(
        2.0, "time that each base/trajectory covers", unit="s", check=between(1.0, 60.0)
    )
    max_age: float = setting(
        0.5,
        "largest age of base/state and arm/joint_states; beyond it (see "
        "joint_timeout) the running action is aborted",
        unit="s",
        check=POSITIVE,
    )
    joint_timeout: float = setting(
        3.0,
        "time for which base/hold, base/go_to and base/follow continue without new "
        "arm/joint_states, with the joints assumed at rest",
        unit="s",
        check=NOT_NEGATIVE,
    )
    speed: float = setting(0.06, "largest speed of the base", unit="m/s", check=POSITIVE)
    acceleration: float = setting(
        0.003, "largest acceleration of the base", unit="m/s^2", check=POSITIVE
    )
    turn_rate: float = setting(0.1, "largest turn rate of the base", unit="rad/s", check=POSITIVE)
    turn_acceleration: float = setting(
        0.003, "largest angular acceleration of the base", unit="rad/s^2", check=POSITIVE
    )
    tolerance: float = setting(
        0.02, "largest position error at which a goal counts as reached", unit="m", check=POSITIVE
    )
    heading_tolerance: float = setting(
        0.03, "largest heading error at which a goal counts as reached", unit="rad", check=POSITIVE
    )
    rest_speed: float = setting(
        0.005, "largest speed at which a goal counts as reached", unit="m/s", check=POSITIVE
    )
    rest_turn_rate: float = setting(
        0.01, "largest turn rate at which a goal counts as reached", unit="rad/s", check=POSITIVE
    )
    max_overrun: float = setting(
        30.0,
        "longest time after the planned arrival; then the goal is aborted",
        unit="s",
        check=POSITIVE,
    )
    max_offset: float = setting(
        0.15,
        "largest position error of the base; beyond it the running action is aborted",
        unit="m",
        check=POSITIVE,
    )
    max_turn: float = setting(
        0.35,
        "largest heading error of the base; beyond it the running action is aborted",
        unit="rad",
        check=POSITIVE,
    )
    keep_out: float = setting(
        0.3,
        "radius about the target's origin that base, arm and gripper enter only to grip",
        unit="m",
        check=NOT_NEGATIVE,
    )
    vehicles: tuple[str, ...] = setting(
        (),
        "names (namespaces) of all vehicles on the table, this one included, by right of way; the "
        "list is alike in each guidance; empty: there is no other one",
    )
    vehicle_gap: float = setting(
        0.1,
        "smallest gap to another vehicle, in addition to 3 standard deviations of its position",
        unit="m",
        check=NOT_NEGATIVE,
    )
    edge_margin: float = like(GuardSettings, "edge_margin")
    target_radius: float = like(GuardSettings, "target_radius")
    gripper_length: float = like(GuardSettings, "gripper_length")
