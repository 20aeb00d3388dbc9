"""Time to calibrate from a bag, compared with reading and deserializing it with rosbags.

An hour of four links at 5 Hz and two VICON subjects at 100 Hz: 792,000 messages, 180 rests and 179
maneuvers between them, on a base that floats.
"""

import argparse
import struct
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
from rosbags.highlevel import AnyReader

from fss_arm_bags.recorder import Recording
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_model.base_motion import base_poses
from fss_arm_model.description import paper_arm
from fss_arm_model.joint_path import path
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.units import SECOND
from fss_arm_ros.qos import SENSOR

START = 1_700_000_000 * SECOND
REST, MOVE = 18.0, 2.0  # [s]
JOINTS = "/joint_states"
SUBJECTS = "/vicon/fss/fss", "/vicon/end_effector/end_effector"


def joint_motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joint angles and rates (k, 4) at times (k,) [s]: smooth moves between postures."""
    k, within = np.divmod(t, REST + MOVE)
    progress = np.clip((within - REST) / MOVE, 0.0, 1.0)[:, None]
    here, there = (DEFAULT_POSTURES[(k.astype(int) + d) % len(DEFAULT_POSTURES)] for d in (0, 1))
    rate = 6.0 * progress * (1.0 - progress) / MOVE
    return here + (3.0 * progress**2 - 2.0 * progress**3) * (there - here), rate * (there - here)


def cdr_pose(t: int, x: float, y: float, heading: float) -> bytes:
    """Return a serialized geometry_msgs/PoseStamped."""
    turn = 0.0, 0.0, np.sin(0.5 * heading), np.cos(0.5 * heading)
    head = struct.pack("<iII6s6x", *divmod(t, SECOND), 6, b"world\0")
    return b"\0\1\0\0" + head + struct.pack("<7d", x, y, 0.0, *turn)


def cdr_joint(t: int, i: int, q: float, qd: float) -> bytes:
    """Return a serialized sensor_msgs/JointState of one link."""
    head = struct.pack("<iIIB3xII8s", *divmod(t, SECOND), 1, 0, 1, 8, b"joint_%d\0" % i)
    return b"\0\1\0\0" + head + b"".join(struct.pack("<I4xd", 1, v) for v in (q, qd, 0.0))


def messages(length: float, noise: float) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamp, topic and data of all messages, in order."""
    rng = np.random.default_rng(1)
    arm = paper_arm().vector()
    t = np.arange(0.0, length, 0.01)
    count = int(length / (REST + MOVE)) + 1
    edges = [k * (REST + MOVE) + part for k in range(count) for part in (0.0, REST)]
    base = base_poses(arm, path(joint_motion, edges, t), np.array([0.3, 1.0, 3.0, 0, 0, 0, 0, 0]))
    tip = tip_pose(arm, np.concatenate([base, joint_motion(t)[0]], axis=-1))
    rest_error = rng.normal(size=(1 + int(length / (REST + MOVE)), 3)) * [0.0177, 0.0177, 0.0125]
    tip += rest_error[(t // (REST + MOVE)).astype(int)]
    rows: list[tuple[int, str, bytes]] = []
    for topic, poses in zip(SUBJECTS, (base, tip), strict=True):
        poses = poses + noise * rng.normal(size=poses.shape)
        stamps = (START + np.round(t * SECOND)).astype(np.int64).tolist()
        rows += [
            (at, topic, cdr_pose(at, *pose))
            for at, pose in zip(stamps, poses.tolist(), strict=True)
        ]
    for i in range(1, 5):
        t = np.arange(0.03 * i, length, 0.2)
        stamps = (START + np.round(t * SECOND)).astype(np.int64).tolist()
        angles, rates = (part[:, i - 1].tolist() for part in joint_motion(t))
        rows += [
            (at, JOINTS, cdr_joint(at, i, q, qd))
            for at, q, qd in zip(stamps, angles, rates, strict=True)
        ]
    yield from sorted(rows, key=lambda row: row[0])


def write(folder: Path, length: float) -> Path:
    """Write the bag like `record`; return its path."""
    bag = Recording(folder)
    bag.add(JOINTS, "sensor_msgs/msg/JointState", [SENSOR])
    for topic in SUBJECTS:
        bag.add(topic, "geometry_msgs/msg/PoseStamped", [SENSOR])
    for t, topic, data in messages(length, 3e-4):
        bag.write(topic, t + SECOND // 200, data)
    bag.close()
    return bag.path


def read(bag: Path) -> int:
    """Read and deserialize all messages with rosbags alone; return their number."""
    count = 0
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            count += 1
    return count


def kinematic(bag: Path) -> str:
    """Solve for lengths and angles; return a summary."""
    found = solve_bag(KINDS["kinematic"], bag)
    return f"{found.verdict}, {found.accepted} observations"


def dynamic(bag: Path) -> str:
    """Solve for masses and inertias; return a summary."""
    found = solve_bag(KINDS["dynamic"], bag)
    return f"{found.verdict}, {found.accepted} maneuvers"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        bag = write(Path(folder), 60.0 * options.minutes)
        size = sum(file.stat().st_size for file in bag.iterdir())
        print(f"{read(bag)} messages, {size / 1e6:.0f} MB")
        print(f"kinematic: {kinematic(bag)}; dynamic: {dynamic(bag)}")
        times: dict[str, list[float]] = {"rosbags": [], "kinematic": [], "dynamic": []}
        for _ in range(options.repeat):
            for name, run in (("rosbags", read), ("kinematic", kinematic), ("dynamic", dynamic)):
                start = process_time()
                run(bag)
                times[name].append(process_time() - start)
    peer, *ours = (median(values) for values in times.values())
    print(f"processor time, medians of {options.repeat} runs:")
    print(f"rosbags: read and deserialize       {peer:8.2f} s")
    print(f"kinematic calibration               {ours[0]:8.2f} s")
    print(f"dynamic calibration                 {ours[1]:8.2f} s")
    print(f"both calibrations / rosbags: {sum(ours) / peer:.2f} (limit 1.5)")


if __name__ == "__main__":
    main()
