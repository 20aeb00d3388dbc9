"""Tasks of the environments: what is observed and commanded, and what is rewarded.

Each task acts on a whole batch. An observation has no units of its own but SI: metres, radians and
their rates, in the axes of the base. An action is from -1 to 1 of what the vehicle can do.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import STATE_NAMES, base_poses
from fss_arm_model.held import Target
from fss_arm_model.joint_path import path
from fss_arm_model.kinematics import tip_pose
from fss_sim.environments.batch import PERIOD, Batch, rotated, wrapped
from fss_sim.plant.target import Gripper

MAX_WRENCH = np.array([0.32, 0.32, 0.07])  # of the base's thrusters [N, N, N m]
START_RANGE = 0.7  # of the joints' ranges, from which postures are drawn
REST_TIME = 5.0  # of the arm between two motions in Hold [s]
ARM_RATE, ARM_ACCELERATION = 0.02, 0.003  # of the joints in Hold [rad/s], [rad/s^2]
SUCCESS_REWARD = 10.0


Rows = npt.NDArray[np.intp]  # numbers of rows of a batch


class Score(NamedTuple):
    """Result of one period, (N,) each."""

    reward: Floats
    terminated: npt.NDArray[np.bool_]  # the episode has ended, by success or failure


class Task(Protocol):
    """Task of a batch of arms."""

    duration: ClassVar[float]  # of an episode [s]
    batch: Batch
    actions: int  # size of an action
    names: tuple[str, ...]  # of the elements of an observation, with their units

    def reset(self, rows: Rows, rng: np.random.Generator) -> None:
        """Start new episodes in these rows of the batch."""

    def step(self, action: Floats) -> Score:
        """Advance by one period with an action (N, actions) from -1 to 1."""

    def observe(self) -> Floats:
        """Return the observations, (N, len(names))."""


def arm_names(n: int) -> tuple[str, ...]:
    """Return the names of the elements that all observations start with."""
    joints = [f"q_{i} [rad]" for i in range(1, n + 1)] + [
        f"qd_{i} [rad/s]" for i in range(1, n + 1)
    ]
    return (*joints, "base v_x [m/s]", "base v_y [m/s]", "base turn rate [rad/s]")


def observe_arm(batch: Batch) -> list[Floats]:
    """Return joints, their rates, and the base's twist in its own axes."""
    return [batch.q[:, 3:], batch.qd[:, 3:], rotated(batch.qd[:, :3], -batch.q[:, 2])]


def offset_names(what: str) -> tuple[str, ...]:
    """Return the names of a pose relative to another."""
    return f"{what} x [m]", f"{what} y [m]", f"cos {what} heading", f"sin {what} heading"


def observe_offset(batch: Batch, pose: Floats, origin: Floats) -> Floats:
    """Return the offset of a pose from an origin, (N, 4), in the base's axes."""
    offset = rotated(pose - origin, -batch.q[:, 2])
    return np.column_stack([offset[:, :2], np.cos(offset[:, 2]), np.sin(offset[:, 2])])


def draw_start(batch: Batch, rows: Rows, rng: np.random.Generator) -> None:
    """Put these rows at rest at the table's centre, with a random heading and posture."""
    count = len(rows)
    batch.q[rows, :2] = 0.0
    batch.q[rows, 2] = rng.uniform(-np.pi, np.pi, count)
    batch.q[rows, 3:] = draw_postures(batch, count, rng)
    batch.qd[rows] = batch.torque[rows] = 0.0


def draw_postures(batch: Batch, count: int, rng: np.random.Generator) -> Floats:
    """Return random postures, (count, n) [rad]."""
    return START_RANGE * rng.uniform(batch.q_min, batch.q_max, (count, batch.n))


def after_motion(p: Floats, q: Floats, postures: Floats) -> Floats:
    """Return the states of arms at rest after straight joint motions, while their bases float.

    Args:
        p: (N, 8 + 6 n) Arm.vector() of each.
        q: (N, 3 + n) states before the motions.
        postures: (N, n) of the joints after them [rad].
    """
    start, travel = q[:, None, 3:], (postures - q[:, 3:])[:, None]

    def law(t: Floats) -> tuple[Floats, Floats]:
        angles = start + t[..., None] * travel
        return angles, np.broadcast_to(travel, angles.shape)

    marks, state = np.tile([0.0, 1.0], (len(q), 1)), np.zeros((len(q), len(STATE_NAMES)))
    state[:, :3] = q[:, :3]
    return np.concatenate([base_poses(p, path(law, marks, marks), state)[:, 1], postures], axis=1)


@dataclass
class Reach:
    """Move the end effector to a fixture in the world; the base floats without thrusters.

    Reward per second: minus the distance [m] and 0.2 of the heading error [rad], minus 0.05 of the
    mean square of the action. 10 and the end for an arrival: within 10 mm, 0.05 rad and 20 mm/s.
    """

    batch: Batch
    duration: ClassVar[float] = 30.0

    def __post_init__(self) -> None:
        self.actions = self.batch.n
        self.names = (*arm_names(self.batch.n), *offset_names("fixture"))
        self.fixture = np.zeros((len(self.batch.q), 3))

    def reset(self, rows: Rows, rng: np.random.Generator) -> None:
        """Draw a start, and a fixture where a motion to another posture has the end effector."""
        batch = self.batch
        draw_start(batch, rows, rng)
        p, postures = batch.p[rows], draw_postures(batch, len(rows), rng)
        self.fixture[rows] = tip_pose(p, after_motion(p, batch.q[rows], postures))

    def step(self, action: Floats) -> Score:
        """Command the joints' rates, and score the end effector's error."""
        self.batch.advance(np.zeros((len(action), 3)), action * self.batch.max_rate)
        pose, twist = self.batch.tip()
        distance = np.hypot(*(self.fixture - pose)[:, :2].T)
        turn = np.abs(wrapped(self.fixture[:, 2] - pose[:, 2]))
        arrived = (distance < 0.01) & (turn < 0.05) & (np.hypot(*twist[:, :2].T) < 0.02)
        cost = distance + 0.2 * turn + 0.05 * np.mean(action**2, axis=1)
        return Score(SUCCESS_REWARD * arrived - PERIOD * cost, arrived)

    def observe(self) -> Floats:
        """Return the arm's state and the fixture relative to the end effector."""
        pose, _ = self.batch.tip()
        offset = observe_offset(self.batch, self.fixture, pose)
        return np.column_stack([*observe_arm(self.batch), offset])


@dataclass
class Hold:
    """Keep the base at its pose with the thrusters while the arm moves from posture to posture.

    Reward per second: 1 minus the squares of the position error per 50 mm and of the heading error
    per 5 degrees, at least -10, minus 0.1 of the mean square of the action.
    """

    batch: Batch
    duration: ClassVar[float] = 60.0

    def __post_init__(self) -> None:
        count, n = len(self.batch.q), self.batch.n
        self.actions = 3
        self.names = (*arm_names(n), *offset_names("desired base"))
        self.desired, (self.goal, self.rates) = np.zeros((count, 3)), np.zeros((2, count, n))
        self.rest, self.rng = np.zeros(count), np.random.default_rng()

    def reset(self, rows: Rows, rng: np.random.Generator) -> None:
        """Draw a start; its pose is the desired one."""
        self.rng = rng
        draw_start(self.batch, rows, rng)
        self.desired[rows], self.goal[rows] = self.batch.q[rows, :3], self.batch.q[rows, 3:]
        self.rates[rows], self.rest[rows] = 0.0, rng.uniform(0.0, REST_TIME, len(rows))

    def step(self, action: Floats) -> Score:
        """Command the base's wrench, and score its error."""
        batch = self.batch
        self.rest -= PERIOD
        due = np.flatnonzero(self.rest <= 0.0)
        self.goal[due] = draw_postures(batch, len(due), self.rng)
        self.rest[due] = self.rng.uniform(REST_TIME, 3.0 * REST_TIME, len(due))
        wanted = np.clip(0.5 * (self.goal - batch.q[:, 3:]), -ARM_RATE, ARM_RATE)
        change = ARM_ACCELERATION * PERIOD
        self.rates += np.clip(wanted - self.rates, -change, change)
        batch.advance(action * MAX_WRENCH, self.rates)
        error = self.desired - batch.q[:, :3]
        square = np.sum(error[:, :2] ** 2, axis=1) / 0.05**2
        square += (wrapped(error[:, 2]) / np.radians(5.0)) ** 2
        reward = np.maximum(1.0 - square, -10.0) - 0.1 * np.mean(action**2, axis=1)
        return Score(PERIOD * reward, np.zeros(len(action), dtype=bool))

    def observe(self) -> Floats:
        """Return the arm's state and the desired pose relative to the base."""
        offset = observe_offset(self.batch, self.desired, self.batch.q[:, :3])
        return np.column_stack([*observe_arm(self.batch), offset])


@dataclass
class Capture:
    """Bring the gripper to the fixture of a tumbling target, with thrusters and arm.

    Reward per second: minus the distance [m], 0.2 of the heading error [rad] and 0.05 of the mean
    square of the action. 10 and the end where the gripper can close. Bodies do not touch: -10 and
    the end if the end effector enters the target by more than the gripper's reach.
    """

    batch: Batch
    duration: ClassVar[float] = 120.0

    def __post_init__(self) -> None:
        count, n = len(self.batch.q), self.batch.n
        self.actions = 3 + n
        self.names = (
            *arm_names(n),
            *offset_names("fixture"),
            "fixture v_x [m/s]",
            "fixture v_y [m/s]",
            "target turn rate [rad/s]",
        )
        self.target, self.gripper = Target(), Gripper()
        self.pose, self.twist = np.zeros((2, count, 3))  # of the target

    def reset(self, rows: Rows, rng: np.random.Generator) -> None:
        """Draw a start, and a target 1.2 to 1.8 m away that turns by up to 0.3 rad/s."""
        count = len(rows)
        draw_start(self.batch, rows, rng)
        distance, direction = rng.uniform(1.2, 1.8, count), rng.uniform(-np.pi, np.pi, count)
        self.pose[rows, 0] = distance * np.cos(direction)
        self.pose[rows, 1] = distance * np.sin(direction)
        self.pose[rows, 2] = rng.uniform(-np.pi, np.pi, count)
        self.twist[rows, :2] = rng.uniform(-0.005, 0.005, (count, 2))
        self.twist[rows, 2] = rng.uniform(-0.3, 0.3, count)

    def fixture(self) -> tuple[Floats, Floats]:
        """Return pose of a gripper at the fixture and the fixture's twist, (N, 3) each."""
        arm = rotated(np.tile(self.target.fixture, (len(self.pose), 1)), self.pose[:, 2])
        pose = self.pose + arm
        pose[:, 2] += np.pi
        turning = self.twist[:, 2:] * np.column_stack([-arm[:, 1], arm[:, 0]])
        return pose, np.column_stack([self.twist[:, :2] + turning, self.twist[:, 2]])

    def step(self, action: Floats) -> Score:
        """Command wrench and joints' rates, and score the gripper's error."""
        batch = self.batch
        batch.advance(action[:, :3] * MAX_WRENCH, action[:, 3:] * batch.max_rate)
        self.pose += PERIOD * self.twist  # a free body about its centre of mass
        (pose, twist), (goal, goal_twist) = batch.tip(), self.fixture()
        distance = np.hypot(*(goal - pose)[:, :2].T)
        turn = np.abs(wrapped(goal[:, 2] - pose[:, 2]))
        speed = np.hypot(*(goal_twist - twist)[:, :2].T)
        grip = self.gripper
        can_grip = (distance <= grip.reach) & (turn <= grip.angle) & (speed <= grip.speed)
        inside = np.hypot(*(self.pose - pose)[:, :2].T) < self.target.radius - grip.reach
        cost = distance + 0.2 * turn + 0.05 * np.mean(action**2, axis=1)
        reward = SUCCESS_REWARD * can_grip - SUCCESS_REWARD * inside - PERIOD * cost
        return Score(reward, can_grip | inside)

    def observe(self) -> Floats:
        """Return the arm's state, and the fixture relative to the end effector."""
        (pose, twist), (goal, goal_twist) = self.batch.tip(), self.fixture()
        relative = rotated(goal_twist - twist, -self.batch.q[:, 2])
        relative[:, 2] = self.twist[:, 2]
        offset = observe_offset(self.batch, goal, pose)
        return np.column_stack([*observe_arm(self.batch), offset, relative])


#: Tasks by the names of their environments.
TASKS: dict[str, Callable[[Batch], Task]] = {
    "FssReach-v0": Reach,
    "FssHold-v0": Hold,
    "FssCapture-v0": Capture,
}
