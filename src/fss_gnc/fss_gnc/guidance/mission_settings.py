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
        0.11,
        "lever of a thruster: from the base's origin to the line of thrust; same value as "
        "thruster_lever of `navigation`",
        unit="m",
        check=POSITIVE,
    )
    authority: float = setting(
        0.5,
        "share of the valves' largest force and torque that plans may use; the rest is for control",
        check=above(0.0, 1.0),
    )
    # the approach
    posture: tuple[float, ...] = setting(
        (), "joint readings of the approach; empty: those at its start", unit="rad", check=FINITE
    )
    stand_off: float = setting(
        0.08,
        "distance of the end effector from the fixture at the end of the approach",
        unit="m",
        check=NOT_NEGATIVE,
    )
    keep_out: float = like(GuidanceSettings, "keep_out", 0.26)
    approach_edge_gap: float = setting(
        0.1,
        "smallest gap between a body and the table's edge on a planned approach",
        unit="m",
        check=NOT_NEGATIVE,
    )
    coast: float = setting(
        12.0,
        "time after a failure of the thrust in which a planned approach stays free of collision",
        unit="s",
        check=NOT_NEGATIVE,
    )
    cancel_momentum: bool = setting(
        False,
        "whether the approach ends in a motion whose momentum is opposite to the target's, so that "
        "little is left to stop after the grip",
    )
    # the reach
    lead: float = setting(
        3.0,
        "time before the turning fixture faces the arm at which the reach starts",
        unit="s",
        check=NOT_NEGATIVE,
    )
    reach_speed: float = setting(
        0.05,
        "largest speed of the end effector relative to the fixture; twice that if the fixture "
        "recedes faster than this",
        unit="m/s",
        check=POSITIVE,
    )
    joint_rate: float = setting(
        0.4,
        "largest rate of a joint; within 5 cm of the fixture the drive's limit applies",
        unit="rad/s",
        check=POSITIVE,
    )
    grip_distance: float = setting(
        0.025,
        "distance from the fixture at which the gripper closes; it must be able to hold from there",
        unit="m",
        check=POSITIVE,
    )
    grip_angle: float = setting(
        0.4, "largest angle to the fixture at which the gripper closes", unit="rad", check=POSITIVE
    )
    grip_speed: float = setting(
        0.08,
        "largest speed relative to the fixture at which the gripper closes; also at most "
        "grip_distance / grip_closing_time",
        unit="m/s",
        check=POSITIVE,
    )
    grip_closing_time: float = setting(
        0.0, "time that the gripper's fingers take to close", unit="s", check=NOT_NEGATIVE
    )
    # slowing down
    grip_force: float = setting(
        0.0, "force at which the grip slides; 0: no limit", unit="N", check=NOT_NEGATIVE
    )
    grip_torque: float = setting(
        0.0, "torque at which the grip slides; 0: no limit", unit="N m", check=NOT_NEGATIVE
    )
    torque_share: float = setting(
        0.5,
        "fraction of the joints' largest torques, and of the grip's limits, that stopping the "
        "joints may use",
        check=above(0.0, 1.0),
    )
    # limits that abort a mission
    wait_timeout: float = setting(
        60.0, "longest wait for a feasible approach", unit="s", check=POSITIVE
    )
    approach_timeout: float = setting(300.0, "longest approach", unit="s", check=POSITIVE)
    reach_timeout: float = setting(
        20.0, "longest reach; then the next attempt starts", unit="s", check=POSITIVE
    )
    grip_timeout: float = setting(
        3.0, "longest time to grip; then the next attempt starts", unit="s", check=POSITIVE
    )
    detumble_timeout: float = setting(180.0, "longest detumble", unit="s", check=POSITIVE)
    attempts: int = setting(
        5, "number of reaches after which the mission is aborted", check=POSITIVE
    )
    min_edge_gap: float = setting(
        0.03,
        "gap between a body and the table's edge below which the mission is aborted",
        unit="m",
        check=NOT_NEGATIVE,
    )
    min_target_gap: float = setting(
        0.02,
        "gap between base or arm and the target below which the mission is aborted",
        unit="m",
        check=NOT_NEGATIVE,
    )
    max_propellant: float = setting(
        0.06, "propellant use at which the mission is aborted", unit="kg", check=POSITIVE
    )
    max_torque: float = setting(
        3.0, "torque of a joint above which the mission is aborted", unit="N m", check=POSITIVE
    )
    # the abort
    drift_horizon: float = setting(
        30.0,
        "time after an abort for which the drift of base and arm must be free of collision; if it "
        "is not, a short push changes it",
        unit="s",
        check=POSITIVE,
    )
    drift_speed: float = setting(
        0.04, "largest drift speed after an abort", unit="m/s", check=POSITIVE
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
