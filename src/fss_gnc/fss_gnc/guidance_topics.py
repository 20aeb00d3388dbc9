"""Topics of the node `guidance`: their types, and the conversion of their messages."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, String
from trajectory_msgs.msg import MultiDOFJointTrajectory

from fss_arm_model.arrays import Floats
from fss_arm_model.description import joint_names
from fss_arm_msgs.msg import (
    BaseTelemetry,
    GripperState,
    MassProperties,
    MissionState,
    ThrusterHealth,
)
from fss_arm_ros.convert import stamp_ns, to_time
from fss_arm_ros.qos import COMMAND, LATCHED, command, subscribe_sensor
from fss_arm_ros.subscriptions import PolledSubscription
from fss_arm_ros.validation import subscribe
from fss_gnc import messages
from fss_gnc.guidance.activity import Commands, Craft, Outcome
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.execution import Execution
from fss_gnc.guidance.kinds import short_reason
from fss_gnc.guidance.measurements import Measurements

POINT_SPACING = 0.25  # between points of base/trajectory [s]
MAX_PUBLISHED_POSES = 32  # largest number of poses of a path in mission/state


def store_base(measured: Measurements, message: Odometry, now: int) -> None:
    """Store the state of the base."""
    measured.base.store(stamp_ns(message.header.stamp), messages.body(message))


def store_target(measured: Measurements, message: Odometry, now: int) -> None:
    """Store the state of the target."""
    measured.target.store(stamp_ns(message.header.stamp), messages.body(message))


def store_joints(measured: Measurements, message: JointState, now: int) -> None:
    """Store the state of all joints."""
    joints = messages.joints(message, measured.n)
    measured.joints.store(stamp_ns(message.header.stamp), joints)


def store_gripper(measured: Measurements, message: GripperState, now: int) -> None:
    """Store whether the gripper holds the target."""
    measured.set_gripper(now, message.holds)


def store_mass(measured: Measurements, message: MassProperties, now: int) -> None:
    """Store the mass properties of the held target."""
    holds = measured.holds.value
    measured.held_body = messages.mass_properties(message) if holds else None


def store_valves(measured: Measurements, message: ThrusterHealth, now: int) -> None:
    """Store the health of the valves."""
    measured.open_valves = tuple((np.flatnonzero(message.stuck_open) + 1).tolist())
    measured.unknown_push = message.pushed


def store_propellant(measured: Measurements, message: Float64, now: int) -> None:
    """Store the remaining propellant."""
    measured.propellant.store(now, message.data)


def store_armed(measured: Measurements, message: BaseTelemetry, now: int) -> None:
    """Store whether the valves may open."""
    measured.armed.store(now, message.armed)


def store_stall(measured: Measurements, message: String, now: int) -> None:
    """Store why control has dropped the reference."""
    measured.stall.store(now, short_reason(message.data, "control paused"))


Store = Callable[[Measurements, Any, int], None]

#: Type and conversion of each topic; conversions raise ValueError for an invalid message.
POLLED: dict[str, tuple[type, Store]] = {
    "base/state": (Odometry, store_base),
    "target/state": (Odometry, store_target),
}
SENSORS: dict[str, tuple[type, Store]] = {
    "arm/joint_states": (JointState, store_joints),
    "gripper/state": (GripperState, store_gripper),
    "target/mass_properties": (MassProperties, store_mass),
    "base/propellant": (Float64, store_propellant),
    "base/telemetry": (BaseTelemetry, store_armed),
    "control/stall": (String, store_stall),
}
RESULTS: dict[str, tuple[type, Store]] = {"thrusters/health": (ThrusterHealth, store_valves)}
#: Type and QoS of each published topic.
OUTPUTS: dict[str, tuple[type, QoSProfile]] = {
    "base/trajectory": (MultiDOFJointTrajectory, command(0.5)),
    "arm/joint_commands": (JointState, command(0.5)),
    "gripper/command": (Bool, COMMAND),
    "mission/state": (MissionState, LATCHED),
}


def subscribe_to_states(
    node: Node, receive: Callable[[str, Store, Any], None]
) -> list[PolledSubscription]:
    """Subscribe a node to all topics; return the subscriptions that it must poll.

    Args:
        node: the subscriber.
        receive: called with the name of the topic, its conversion and a valid message.
    """
    for name, (kind, store) in SENSORS.items():
        subscribe_sensor(node, kind, name, partial(receive, name, store))
    for name, (kind, store) in RESULTS.items():
        subscribe(node, kind, name, partial(receive, name, store), LATCHED)
    return [
        PolledSubscription(node, kind, name, partial(receive, name, store))
        for name, (kind, store) in POLLED.items()
    ]


def idle_messages(craft: Craft, stamp: int) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of the mission's state without an activity, at a time [ns]."""
    yield "mission/state", mission_state("", Commands("idle"), Budget(craft), stamp)


def command_messages(
    execution: Execution, commands: Commands, t: float, horizon: float, stamp: int
) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of each command of an activity, and of the mission's state.

    Args:
        execution: of the activity.
        commands: its newest commands.
        t: time since its start [s].
        horizon: length of the published part of the path [s].
        stamp: present time [ns].
    """
    path = messages.trajectory(commands.path, t, stamp, horizon, POINT_SPACING)
    yield "base/trajectory", path
    if commands.rates is not None:
        yield "arm/joint_commands", joint_command(commands.rates, stamp)
    if commands.close_gripper is not None:
        yield "gripper/command", Bool(data=commands.close_gripper)
    name, budget = execution.kind.name, execution.budget
    yield "mission/state", mission_state(name, commands, budget, stamp)


def end_messages(
    execution: Execution, outcome: Outcome, n: int, stamp: int, *, coast: bool
) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of each command that ends an activity, and of the mission's state.

    Args:
        execution: of the activity.
        outcome: its outcome.
        n: number of joints.
        stamp: present time [ns].
        coast: True if the valves close and the joints stop; False if another activity follows.
    """
    if coast:
        yield "base/trajectory", messages.trajectory(None, 0.0, stamp, 0.0, POINT_SPACING)
    if coast and execution.moves_joints:
        yield "arm/joint_commands", joint_command(np.zeros(n), stamp)
    commands = Commands("done" if outcome.success else "abort", outcome=outcome)
    name, budget = execution.kind.name, execution.budget
    yield "mission/state", mission_state(name, commands, budget, stamp)


def joint_command(rates: Floats, stamp: int) -> JointState:
    """Return rates of all joints (n,) [rad/s] as a command at a time [ns]."""
    values = np.asarray(rates, dtype=float).tolist()
    message = JointState(name=joint_names(len(values)), velocity=values)
    message.header.stamp = to_time(stamp)
    return message


def mission_state(name: str, commands: Commands, budget: Budget, stamp: int) -> MissionState:
    """Return the state of the mission, and the resources that it has used.

    Args:
        name: of the action; empty if there is none.
        commands: its newest commands.
        budget: its resources.
        stamp: present time [ns].
    """
    reason = commands.outcome.message if commands.outcome else commands.reason
    state = MissionState(
        mission=name.partition("/")[2],
        phase=commands.phase,
        reason=reason,
        elapsed=budget.elapsed,
        reference=np.full(3, np.nan),
        keep_out=commands.keep_out,
        fixture_distance=commands.fixture_distance,
        edge_clearance=budget.edge_gap,
        target_clearance=budget.target_gap,
        propellant=budget.propellant,
        momentum=budget.momentum,
        largest_torque=budget.largest_torque,
    )
    state.header.stamp, state.header.frame_id = to_time(stamp), "world"
    if commands.path is not None:
        path = commands.path.sample(budget.elapsed, MAX_PUBLISHED_POSES)[1]
        state.reference, state.path = path[0, 0], path[:, 0].ravel().tolist()
    return state
