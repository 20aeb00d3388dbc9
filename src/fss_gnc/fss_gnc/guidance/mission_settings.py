"""Parameters of the node `guidance`: those of the base's motion, and those of the missions."""

from dataclasses import dataclass

from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.held import Target
from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    above,
    like,
    setting,
)
from fss_gnc.guidance.settings import GuidanceSettings


@dataclass(frozen=True)
class MissionSettings(GuidanceSettings, GuardSettings):
    """Parameters of a GuidanceNode, those of capture, detumble and abort included."""

    target_mass: float = like(Target, "mass")
    target_inertia: float = like(Target, "inertia")
    target_fixture: tuple[float, ...] = like(Target, "fixture")
    thrust: float = setting(0.16, "thrust of a valve", unit="N", check=POSITIVE)
    lever: float = setting(
        0.11, "lever of a valve: from the base's origin to its line of thrust", unit="m",
        check=POSITIVE,
    )  # fmt: skip
    authority: float = setting(
        0.5, "share of the valves' authority that a reference may take", check=above(0.0, 1.0)
    )
    # the approach
    posture: tuple[float, ...] = setting(
        (), "joint angles of the approach; empty: as they are when it begins", unit="rad",
        check=FINITE,
    )  # fmt: skip
    stand_off: float = setting(
        0.08, "distance of the end effector from the fixture before it reaches for it", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    keep_out: float = like(GuidanceSettings, "keep_out", 0.26)
    edge_room: float = setting(
        0.1, "least distance of all bodies to the table's edge on the planned way", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    coast: float = setting(
        12.0, "time for which nothing is met if all thrust ends anywhere on the way", unit="s",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    longest_way: float = setting(
        150.0, "longest approach that is planned", unit="s", check=POSITIVE
    )
    # the reach
    lead: float = setting(
        3.0, "the reach begins so long before the fixture faces the arm", unit="s",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    reach_speed: float = setting(
        0.05, "most speed of the end effector past the fixture", unit="m/s", check=POSITIVE
    )
    joint_rate: float = setting(0.4, "most rate of a joint", unit="rad/s", check=POSITIVE)
    grip_distance: float = setting(
        0.025, "distance from the fixture at which the gripper closes", unit="m", check=POSITIVE
    )
    grip_angle: float = setting(
        0.4, "most angle against the fixture at which the gripper closes", unit="rad",
        check=POSITIVE,
    )  # fmt: skip
    grip_speed: float = setting(
        0.08, "most speed past the fixture at which the gripper closes", unit="m/s", check=POSITIVE
    )
    # slowing down
    torque_share: float = setting(
        0.5, "share of the joints' largest torques that slowing down may take",
        check=above(0.0, 1.0),
    )  # fmt: skip
    # limits that abort a mission
    wait_timeout: float = setting(60.0, "longest wait for a clear way", unit="s", check=POSITIVE)
    approach_timeout: float = setting(300.0, "longest approach", unit="s", check=POSITIVE)
    reach_timeout: float = setting(20.0, "longest reach, then it is tried anew", unit="s",
                                   check=POSITIVE)  # fmt: skip
    grip_timeout: float = setting(
        3.0, "time for the gripper to hold what it closed on, then it is tried anew", unit="s",
        check=POSITIVE,
    )  # fmt: skip
    detumble_timeout: float = setting(180.0, "longest detumble", unit="s", check=POSITIVE)
    attempts: int = setting(5, "reaches before the mission is aborted", check=POSITIVE)
    least_edge: float = setting(
        0.03, "distance of a body to the table's edge at which the mission is aborted", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    least_target: float = setting(
        0.02, "distance of base or arm to the target at which the mission is aborted", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    max_propellant: float = setting(
        0.06, "most propellant that a mission may use", unit="kg", check=POSITIVE
    )
    max_torque: float = setting(
        3.0, "torque of a joint at which the mission is aborted", unit="N m", check=POSITIVE
    )
    # the abort
    drift_horizon: float = setting(
        30.0, "time for which what drifts after an abort must meet nothing", unit="s",
        check=POSITIVE,
    )  # fmt: skip
    drift_speed: float = setting(
        0.04, "most speed to drift away with after an abort", unit="m/s", check=POSITIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.keep_out < self.target_radius:
            raise SettingError(
                f"keep_out is {self.keep_out:g} m, expected at least target_radius, "
                f"{self.target_radius:g} m"
            )

    @property
    def target(self) -> Target:
        """Target with its assumed mass, inertia and fixture."""
        return Target(self.target_mass, self.target_inertia, self.target_fixture)
