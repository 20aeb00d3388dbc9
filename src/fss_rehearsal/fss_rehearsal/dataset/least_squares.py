"""Plain least squares on the rests of a bag, for comparison: no weights, outliers or clocks."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.highlevel import AnyReader
from scipy.optimize import least_squares

Floats = npt.NDArray[np.float64]
PERIOD, SECOND = 0.1, 10  # of samples [s]; samples in 1 s
AT_REST = 1e-3  # largest motion of a joint at rest in 1 s [rad]


def read(bag: Path) -> dict[str, Floats]:
    """Return time [s] and values of each joint (k, 2), and of each subject's pose (k, 4)."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            if not connection.msgtype.endswith(("/JointState", "/PoseStamped")):
                continue
            m: Any = reader.deserialize(data, connection.msgtype)
            t = m.header.stamp.sec % 100_000 + 1e-9 * m.header.stamp.nanosec
            if connection.msgtype.endswith("/JointState"):
                rows.setdefault(m.name[0], []).append((t, m.position[0]))
            elif any(h := (m.pose.orientation.z, m.pose.orientation.w)):  # zero: not visible
                pose = t, m.pose.position.x, m.pose.position.y, 2.0 * np.arctan2(*h)
                rows.setdefault(connection.topic, []).append(pose)
    return {name: np.array(row) for name, row in rows.items()}


def rests(streams: dict[str, Floats], base: str, tip: str) -> tuple[Floats, Floats]:
    """Return mean joint angles (r, n), and mean poses of the end effector in the base frame."""
    names = sorted(name for name in streams if name.startswith("joint_"))
    ends = [(s[0, 0], s[-1, 0]) for s in streams.values()]
    t = np.arange(max(a for a, _ in ends), min(b for _, b in ends), PERIOD)
    q = np.column_stack([np.interp(t, *streams[name].T) for name in names])
    seen = [
        np.column_stack([np.interp(t, s[:, 0], c) for c in (s[:, 1], s[:, 2], np.unwrap(s[:, 3]))])
        for s in (streams[base], streams[tip])
    ]
    away = seen[1][:, 0] - seen[0][:, 0] + 1j * (seen[1][:, 1] - seen[0][:, 1])
    away *= np.exp(-1j * seen[0][:, 2])
    poses = np.column_stack([away.real, away.imag, seen[1][:, 2] - seen[0][:, 2]])
    still = np.r_[np.zeros(SECOND, bool), np.abs(q[SECOND:] - q[:-SECOND]).max(axis=1) < AT_REST]
    parts = np.split(np.arange(len(t)), np.flatnonzero(np.diff(still)) + 1)
    parts = [part for part in parts if still[part[0]] and len(part) > SECOND]
    return np.array([q[p].mean(axis=0) for p in parts]), np.array(
        [poses[p].mean(axis=0) for p in parts]
    )


def fit(q: Floats, poses: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Return kinematic parameters, as named by `kinematic_names`, and their deviations."""
    n = q.shape[1]

    def residuals(x: Floats) -> Floats:
        a, offsets, mount = x[:n], np.r_[0.0, x[n : 2 * n - 1]], x[2 * n - 1 :]
        heading = mount[2] + np.cumsum(q + offsets, axis=1)
        tip = complex(*mount[:2]) + np.exp(1j * heading) @ a
        turn = np.angle(np.exp(1j * (poses[:, 2] - heading[:, -1])))
        return np.concatenate([poses[:, 0] - tip.real, poses[:, 1] - tip.imag, turn])

    found = least_squares(residuals, start)
    if np.linalg.matrix_rank(found.jac) < len(start) or 3 * len(q) <= len(start):
        return found.x, np.full(len(start), np.inf)  # too few rests
    scale = 2.0 * found.cost / (3 * len(q) - len(start))
    return found.x, np.sqrt(scale * np.diag(np.linalg.inv(found.jac.T @ found.jac)))
