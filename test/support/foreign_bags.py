"""Bags of other arms by MuJoCo and rosbags.

Nothing of them is made by our plant, our kinematics, our base motion or our recorder.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

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


def make(
    folder: Path,
    n: int,
    seed: int,
    dynamic: bool,
    spoil: Callable[[Heard, np.random.Generator], None] | None = None,
    noise: int = 0,
    fresh: np.ndarray = FRESH,
) -> tuple[Path, Path]:
    """A bag, and the description that its laboratory has."""
    what = heard(flight(n, seed, dynamic), 1000 * seed + noise, dynamic, fresh)
    if spoil:
        spoil(what, np.random.default_rng([19, seed]))
    folder.mkdir(parents=True, exist_ok=True)
    save(described(arm(n, seed), 1000 * seed + noise, dynamic), folder / "arm.yaml")
    return write(folder / "bag", what), folder / "arm.yaml"
