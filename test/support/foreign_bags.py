"""Bags of other arms by MuJoCo and rosbags, good ones and such as go wrong in laboratories.

Nothing of them is made by our plant, our kinematics, our base motion or our recorder.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from model_oracles import mujoco_model
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fss_arm_model.description import Arm, Base, Link
from fss_arm_model.description_file import save
from fss_arm_model.units import SECOND

START = 1_750_000_000 * SECOND
STORE = get_typestore(Stores.ROS2_JAZZY)
COUNTS = 240_000
RATE, JOINT_RATE = 50, 10  # of cameras and gyro, and of readings [Hz]
MOVE = 2.5  # [s]
STEP = 0.0025  # of the simulation [s]
LAG = 0.005  # of receipt [s]

#: Errors of a pose, the same for all of a tenth of a second, and for four: where the dynamics are
#: measured, cameras err by a tenth of the latter.
FRESH = np.array([0.0005, 0.0005, np.radians(0.1)])
SLOW = np.array([0.0007, 0.0007, np.radians(0.07)])
COARSE = np.array([0.001, 0.001, np.radians(0.5)])  # of the worst cameras that defaults accept


def arm(n: int, seed: int) -> Arm:
    """An arm of n unlike links, the outer ones lighter."""
    rng = np.random.default_rng([n, seed])
    links = []
    for i in range(n):
        a, mass = rng.uniform(0.26, 0.45), rng.uniform(1.8, 3.0) * (1.0 - 0.06 * i)
        b, inertia = a * rng.uniform(0.35, 0.65), mass * a**2 * rng.uniform(0.09, 0.14)
        theta_0 = rng.uniform(-0.15, 0.15) if i else 0.0
        links.append(Link(a=a, mass=mass, inertia=inertia, b=b, theta_0=theta_0))
    mount = (rng.uniform(0.15, 0.25), rng.uniform(-0.06, 0.06), rng.uniform(-0.5, 0.5))
    base = Base(mass=rng.uniform(9.0, 14.0), inertia=rng.uniform(0.2, 0.4), mount=mount)
    return Arm("foreign", base, tuple(links))


def described(truth: Arm, seed: int, dynamic: bool) -> Arm:
    """What its laboratory believes of it: by drawings; or measured, but for b, I and the base."""
    rng, n = np.random.default_rng([7, seed]), truth.n
    lengths = np.array([link.a for link in truth.links])
    offsets = np.array([link.theta_0 for link in truth.links[1:]])
    mount = np.array(truth.base.mount)
    place, turn = (0.0005, 0.0017) if dynamic else (0.008, 0.05)
    lengths = lengths + place * rng.uniform(-1.0, 1.0, n)
    offsets = offsets + turn * rng.uniform(-1.0, 1.0, n - 1)
    mount = mount + np.array([place, place, turn]) * rng.uniform(-1.0, 1.0, 3)
    known = truth.with_kinematics([*lengths.tolist(), *offsets.tolist(), *mount.tolist()])
    base = replace(known.base, inertia=truth.base.inertia * rng.uniform(0.93, 1.07))
    links = tuple(
        replace(link, b=link.a * 0.5, inertia=link.inertia * rng.uniform(0.75, 1.25))
        for link in known.links
    )
    return replace(known, base=base, links=links)


@dataclass(frozen=True)
class Flight:
    """What happened: at RATE, poses of base and end effector; at JOINT_RATE, joints."""

    t: np.ndarray  # (k,) [s]
    base: np.ndarray  # (k, 3)
    tip: np.ndarray  # (k, 3)
    spin: np.ndarray  # (k,) of the base [rad/s]
    at: np.ndarray  # (m,) of readings [s]
    q: np.ndarray  # (m, n)
    qd: np.ndarray  # (m, n)


def targets(n: int, count: int, seed: int, wide: float) -> np.ndarray:
    rng = np.random.default_rng([11, seed])
    return rng.choice([-1.0, 1.0], (count, n)) * rng.uniform(0.25, wide, (count, n))


@cache
def flight(n: int, seed: int, dynamic: bool, rest: float = 0.0, count: int = 0) -> Flight:
    """An arm that goes from posture to posture, afloat, by torques; at STEP."""
    truth = arm(n, seed)
    rest = rest or (4.6 if dynamic else 3.0)
    postures = targets(n, count or (5 + 4 * n if dynamic else 14), seed, 1.45)
    model = mujoco_model(truth)
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[3:] = postures[0]
    data.qpos[:3] = [0.1, -0.2, 0.4 * (seed % 5)]
    rng = np.random.default_rng([13, seed])
    data.qvel[:3] = rng.uniform(-1.0, 1.0, 3) * [0.004, 0.004, 0.003]
    last, length = model.body(f"link_{n}").id, truth.links[-1].a
    base = model.body("base").id
    period = rest + MOVE

    def wanted(t):
        """Joint angles and rates to be at time t [s]: a rest, then a smooth move."""
        leg = min(int(t // period), len(postures) - 1)
        x = np.clip((t - leg * period - rest) / MOVE, 0.0, 1.0)
        step = postures[min(leg + 1, len(postures) - 1)] - postures[leg]
        q = postures[leg] + step * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        return q, step * 30.0 * x**2 * (1.0 - x) ** 2 / MOVE

    steps = round(len(postures) * period / STEP)
    every = {"pose": round(1.0 / RATE / STEP), "joint": round(1.0 / JOINT_RATE / STEP)}
    poses, joints = [], []
    mujoco.mj_forward(model, data)
    inertia = np.empty((model.nv, model.nv))
    for k in range(steps):
        t = k * STEP
        if k % every["pose"] == 0:
            R = data.xmat[last].reshape(3, 3)
            end = data.xpos[last] + R @ [length, 0.0, 0.0]
            there = data.xmat[base].reshape(3, 3)
            turns = [np.arctan2(M[1, 0], M[0, 0]) for M in (there, R)]
            poses.append([t, *data.xpos[base][:2], turns[0], *end[:2], turns[1], data.qvel[2]])
        if k % every["joint"] == 0:
            joints.append([t, *data.qpos[3:], *data.qvel[3:]])
        if dynamic:
            if k % 8 == 0:
                mujoco.mj_fullM(model, data, inertia)
                gain = np.linalg.inv(np.linalg.inv(inertia)[3:, 3:])
            want, rate = wanted(t)
            pull = 400.0 * (want - data.qpos[3:]) + 40.0 * (rate - data.qvel[3:])
            data.qfrc_applied[3:] = gain @ pull
            mujoco.mj_step(model, data)
        elif (k + 1) % every["pose"] == 0:
            t = (k + 1) * STEP
            data.qpos[:3] = [0.1 + 0.004 * t, -0.2 - 0.003 * t, 0.4 * (seed % 5) + 0.002 * t]
            data.qpos[3:], data.qvel[3:] = wanted(t)
            mujoco.mj_kinematics(model, data)
        elif k == 0:
            mujoco.mj_kinematics(model, data)
    p, j = np.array(poses), np.array(joints)
    return Flight(p[:, 0], p[:, 1:4], p[:, 4:7], p[:, 7], j[:, 0], j[:, 1 : n + 1], j[:, n + 1 :])


@dataclass
class Heard:
    """What a bag will hold, to be spoilt: stamps and receipts in [s] since START."""

    joints: dict[str, np.ndarray]  # name: (m, 4) stamp, receipt, q, qd
    poses: dict[str, np.ndarray]  # subject: (k, 9) stamp, receipt, x y z, quaternion x y z w
    gyro: np.ndarray  # (k, 3) stamp, receipt, rate
    frames: dict[str, str] = field(
        default_factory=lambda: {"fss": "world", "end_effector": "world"}
    )
    start: dict[str, int] = field(default_factory=dict)  # of a stream's clock, if not START [ns]


def heard(one: Flight, seed: int, dynamic: bool, fresh: np.ndarray = FRESH) -> Heard:
    """A flight as its sensors report it."""
    rng = np.random.default_rng([17, seed])
    count = 2 * np.pi / COUNTS
    columns = zip(count * np.round(one.q.T / count), one.qd.T, strict=True)
    joints = {
        f"joint_{i}": np.column_stack([one.at, one.at + LAG, q, qd])
        for i, (q, qd) in enumerate(columns, 1)
    }
    poses = {}
    lasting = SLOW * (0.1 if dynamic else 1.0)
    for name, seen in (("fss", one.base), ("end_effector", one.tip)):
        tenth = (one.t * 10).astype(int)
        slow = (one.t / 4.0).astype(int)
        error = fresh * rng.standard_normal((tenth[-1] + 1, 3))[tenth]
        error += lasting * rng.standard_normal((slow[-1] + 1, 3))[slow]
        x, y, heading = (seen + error).T
        zero = np.zeros(len(one.t))
        quaternion = [zero, zero, np.sin(0.5 * heading), np.cos(0.5 * heading)]
        height = zero + (0.25 if name == "fss" else 0.3)
        poses[name] = np.column_stack([one.t, one.t + LAG, x, y, height, *quaternion])
    rate = one.spin + 2e-4 * rng.standard_normal(len(one.t))
    return Heard(joints, poses, np.column_stack([one.t, one.t + LAG, rate]))


def stamp(t: float, start: int):
    sec, nanosec = divmod(start + round(t * SECOND), SECOND)
    return STORE.types["builtin_interfaces/msg/Time"](int(sec), int(nanosec))


def write(folder: Path, what: Heard) -> Path:
    """The bag, by rosbags' writer."""
    T = STORE.types
    header, point = T["std_msgs/msg/Header"], T["geometry_msgs/msg/Point"]
    turn, vector = T["geometry_msgs/msg/Quaternion"], T["geometry_msgs/msg/Vector3"]
    pose, stamped = T["geometry_msgs/msg/Pose"], T["geometry_msgs/msg/PoseStamped"]
    state, imu = T["sensor_msgs/msg/JointState"], T["sensor_msgs/msg/Imu"]
    rows = []
    names = list(what.joints)
    by_time: dict[tuple[float, float], list[int]] = {}
    for i, name in enumerate(names):
        for k, (t, receipt, *_) in enumerate(what.joints[name]):
            by_time.setdefault((t, receipt), []).append((i, k))
    for (t, receipt), which in by_time.items():
        values = np.array([what.joints[names[i]][k, 2:] for i, k in which])
        start = what.start.get("joints", START)
        message = state(
            header(stamp(t, start), ""),
            [names[i] for i, _ in which],
            *np.ascontiguousarray(values.T),
            np.empty(0),
        )
        rows.append((receipt, "/joint_states", state.__msgtype__, message))
    for name, track in what.poses.items():
        start = what.start.get(name, START)
        for t, receipt, *numbers in track.tolist():
            message = stamped(
                header(stamp(t, start), what.frames[name]),
                pose(point(*numbers[:3]), turn(*numbers[3:])),
            )
            rows.append((receipt, f"/vicon/{name}/{name}", stamped.__msgtype__, message))
    none = np.zeros(9)
    for t, receipt, rate in what.gyro.tolist():
        head, level = header(stamp(t, what.start.get("gyro", START)), ""), turn(0.0, 0.0, 0.0, 1.0)
        rates = vector(0.0, 0.0, rate), none, vector(0.0, 0.0, 0.0), none
        message = imu(head, level, none, *rates)
        rows.append((receipt, "/fog/imu", imu.__msgtype__, message))
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections = {}
        for receipt, topic, kind, message in sorted(rows, key=lambda row: row[0]):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(message, kind)
            bag.write(connections[topic], START + round(receipt * SECOND), data)
    return folder


Rng = np.random.Generator


class Kind:
    """A way to spoil a bag, what the verdict must begin with, and settings that are given."""

    def __init__(
        self, name: str, says: str, spoil: Callable[..., None], *args: Any, **options: object
    ) -> None:
        self.name, self.says, self.options = name, re.compile(says), options
        self._spoil, self._args = spoil, args

    def spoil(self, what: Heard, rng: Rng) -> None:
        self._spoil(what, rng, *self._args)

    def named(self, reasons: tuple[str, ...]) -> bool:
        return bool(reasons) and bool(self.says.search(reasons[0]))


def _millimeters(what: Heard, _: Rng, *names: str) -> None:
    for name in names or what.poses:
        what.poses[name][:, 2:5] *= 1e3


def _joint(what: Heard, rng: Rng, change: Callable[[np.ndarray], None]) -> None:
    change(list(what.joints.values())[rng.integers(1, len(what.joints))])


def _joints(what: Heard, _: Rng, change: Callable[[np.ndarray], None]) -> None:
    for track in what.joints.values():
        change(track)


def _degrees(track: np.ndarray) -> None:
    track[:, 2:] *= np.degrees(1.0)


def _negated(track: np.ndarray) -> None:
    track[:, 2:] *= -1.0


def _counts(track: np.ndarray) -> None:
    track[:, 2:] *= COUNTS / (2 * np.pi)
    track[:, 2] = np.round(track[:, 2])


def _wrap(what: Heard, _: Rng) -> None:
    for name in list(what.joints)[1:2]:
        q = what.joints[name][:, 2]
        middle = 0.5 * (q.max() + q.min())
        what.joints[name][:, 2] = (q - middle) % (2 * np.pi) + middle


def _exchange(what: Heard, rng: Rng) -> None:
    names = list(what.joints)
    k = int(rng.integers(0, len(names) - 1))
    a, b = names[k], names[k + 1]
    what.joints[a], what.joints[b] = what.joints[b], what.joints[a]


def _columns(what: Heard, _: Rng, order: list[int], signs: list[int]) -> None:
    for track in what.poses.values():
        track[:, 2:] = track[:, 2:][:, order] * signs


def _swap(what: Heard, _: Rng) -> None:
    a, b = what.poses["fss"], what.poses["end_effector"]
    what.poses.update({"fss": b, "end_effector": a})


def _late(what: Heard, _: Rng, by: float) -> None:
    for track in [*what.joints.values(), what.gyro]:
        track[:, 0] += by


def _boot(what: Heard, _: Rng) -> None:
    what.start.update({"joints": 4321 * SECOND, "gyro": 4321 * SECOND})


def _renamed(what: Heard, _: Rng) -> None:
    what.joints = {f"q{i}": track for i, track in enumerate(what.joints.values(), 1)}


def _rare(what: Heard, _: Rng) -> None:
    what.joints = {name: track[:: 2 * JOINT_RATE] for name, track in what.joints.items()}


def _restless(what: Heard, rng: Rng) -> None:
    for track in what.joints.values():
        track[:, 2] += 0.003 * rng.standard_normal(len(track))


def _relative(what: Heard, _: Rng) -> None:
    base, tip = what.poses["fss"], what.poses["end_effector"]
    turn = [2.0 * np.arctan2(track[:, 7], track[:, 8]) for track in (base, tip)]
    away = (tip[:, 2] - base[:, 2]) + 1j * (tip[:, 3] - base[:, 3])
    away = away * np.exp(-1j * turn[0])
    half = 0.5 * (turn[1] - turn[0])
    tip[:, 2], tip[:, 3] = away.real, away.imag
    tip[:, 7], tip[:, 8] = np.sin(half), np.cos(half)
    what.frames["end_effector"] = "fss"


def _gyro_degrees(what: Heard, _: Rng) -> None:
    what.gyro[:, 2] = np.degrees(what.gyro[:, 2])


def _jump(what: Heard, _: Rng, by: float) -> None:
    """The joints' clock, set in the middle of the bag."""
    for track in [*what.joints.values(), what.gyro]:
        track[track[:, 0] > 0.5 * track[-1, 0], 0] += by


def _backwards(track: np.ndarray) -> None:
    track[:, 0] = track[-1, 0] - track[:, 0]


def _unstamped(what: Heard, _: Rng) -> None:
    what.start["joints"] = 0
    for track in what.joints.values():
        track[:, 0] = 0.0


def _no_turn(what: Heard, _: Rng) -> None:
    what.poses["fss"][:, 5:] = 0.0


def _turned(what: Heard, _: Rng) -> None:
    """The end effector's subject, by 90 degrees."""
    track = what.poses["end_effector"]
    half = np.arctan2(track[:, 7], track[:, 8]) + 0.25 * np.pi
    track[:, 7], track[:, 8] = np.sin(half), np.cos(half)


def _frozen(what: Heard, _: Rng) -> None:
    track = what.poses["end_effector"]
    track[len(track) // 8 :, 2:] = track[len(track) // 8, 2:]


def _fast(track: np.ndarray) -> None:
    track[:, 3] = np.degrees(track[:, 3])


def _same(_: Heard, __: Rng) -> None:
    """Nothing is spoilt but what is asked."""


STRAIGHT = [0, 1, 2, 3, 4, 5, 6]  # order of the columns of poses
MILLIMETERS = Kind(
    "millimeters", r"^position in millimeters\?", _millimeters, "fss", "end_effector"
)
DEGREES = Kind("degrees", r"^joints in degrees\?", _joints, _degrees)
SIGN = Kind("one sign", r"^joint_\d with the wrong sign\?", _joint, _negated)
ORDER = Kind("order", r"^joint_\d and joint_\d swapped\?", _exchange)
SIGNS = Kind("all signs", r"^all joints with the wrong sign\?", _joints, _negated)
MIRRORED = Kind("mirrored", r"^poses mirrored\?", _columns, STRAIGHT, [1, -1, 1, -1, 1, -1, 1])
W_FIRST = Kind("w first", r"^quaternions with w first\?", _columns, [0, 1, 2, 6, 3, 4, 5], [1] * 7)
Y_UP = Kind("y up", r"^poses with y up\?", _columns, [0, 2, 1, 3, 5, 4, 6], [1, 1, -1, 1, 1, -1, 1])
SWAPPED = Kind("swapped", r"^base and end effector are swapped", _swap)
HOUR_APART = Kind("an hour", r"^clock of the joints .*\(an hour\) ahead", _late, 3600.0)
STREAMS = [
    Kind(
        "clock set",
        r"^clock of the joints(, gyro)? jumps ahead by 30 s, \d+ s after its first message",
        _jump,
        30.0,
    ),
    Kind("clock backwards", r"^clock of the joints runs backwards", _joints, _backwards),
    Kind("no stamps", r"^stamps of the joints are 0", _unstamped),
    Kind("no quaternions", r"^quaternions of fss are 0", _no_turn),
]  # fmt: skip

KINEMATIC = [
    MILLIMETERS, DEGREES, SIGN, ORDER, SIGNS, MIRRORED, W_FIRST, Y_UP, SWAPPED, HOUR_APART,
    *STREAMS,
    Kind("millimeters, one", r"^position of end_effector in millimeters\?", _millimeters,
         "end_effector"),
    Kind("end effector turned", r"^end effector's subject rotated .* with --theta-e", _turned),
    Kind("degrees, one joint", r"^joint_\d in degrees\?", _joint, _degrees),
    Kind("counts", r"^joints in counts\?", _joints, _counts),
    Kind("headings clockwise", r"^headings clockwise\?", _columns, STRAIGHT,
         [1, 1, 1, 1, 1, -1, 1]),
    Kind("clocks 3 s apart", r"^clock of the joints (3|2\.9\d|3\.0\d) s ahead", _late, 3.0),
    Kind("since boot", r"^clock of the joints .*from its start", _boot),
    Kind("other names", r"^joints named q1, q2", _renamed),
    Kind("seen from the base", r"^end effector already relative to the base\?", _relative),
    Kind("taken as equal", r"^links of different lengths", _same, parametrization="equal"),
    Kind("joints at 0.5 Hz", r"^joints sampled only every 2 s", _rare),
    Kind("never still", r"^joints never at rest", _restless),
]  # fmt: skip
DYNAMIC = [
    MILLIMETERS, DEGREES, SIGN, ORDER, SIGNS, MIRRORED, W_FIRST, Y_UP, SWAPPED, HOUR_APART,
    *STREAMS,
    Kind("end effector frozen", r"^pose of end_effector frozen for \d+ s", _frozen),
    Kind("deg/s", r"^joint velocities in degrees per second\?", _joints, _fast),
    Kind("one wrapped", r"^joint_\d wrapped\?", _wrap),
    Kind("gyro in degrees", r"^gyro in degrees per second\?", _gyro_degrees),
]  # fmt: skip


def make(
    folder: Path,
    n: int,
    seed: int,
    dynamic: bool,
    kind: Kind | None = None,
    noise: int = 0,
    fresh: np.ndarray = FRESH,
) -> tuple[Path, Path]:
    """A bag, and the description that its laboratory has."""
    what = heard(flight(n, seed, dynamic), 1000 * seed + noise, dynamic, fresh)
    if kind:
        kind.spoil(what, np.random.default_rng([19, seed]))
    folder.mkdir(parents=True, exist_ok=True)
    save(described(arm(n, seed), 1000 * seed + noise, dynamic), folder / "arm.yaml")
    return write(folder / "bag", what), folder / "arm.yaml"
