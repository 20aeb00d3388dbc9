"""A floating arm that makes maneuvers, as its streams: joints at 5 Hz, the base and its gyro."""

import numpy as np
from calib_maneuvers import ARM, moves
from calib_rig import COUNT, Sample, at

from fss_arm_model import base_motion, joint_path
from fss_arm_model.kinematics import tip_in_base


def postures(count, seed=0, n=4):
    """Maneuvers of two moves each: (count, 3, n), each beginning where the last one ended."""
    rng = np.random.default_rng(seed)
    q = rng.choice([-1.0, 1.0], (2 * count + 1, n)) * rng.uniform(0.6, 1.5, (2 * count + 1, n))
    return np.array([q[2 * k : 2 * k + 3] for k in range(count)])


class Float:
    """Rests of `rest` s, and between them a maneuver through each row of `ways` (k, w, n).

    Args:
        ways: joint angles.
        vector: Arm.vector() of the truth.
        state: (8) of base_motion at the start.
        noise: 1 sigma of position [m] and heading [rad], fresh every 0.1 s.
    """

    def __init__(self, ways, vector=None, state=None, rest=5.2, noise=(0.0, 0.0), seed=0):
        self.laws = [moves(way) for way in ways]
        lengths = np.array([edges[-1] for _, edges in self.laws])
        self.begins = rest + np.concatenate([[0.0], np.cumsum(lengths + rest)[:-1]])
        self.ends = self.begins + lengths
        self.length = float(self.ends[-1] + rest)
        self.ways, self.noise, self.rng = ways, noise, np.random.default_rng(seed)
        self.vector = ARM.vector() if vector is None else vector
        self.state = np.zeros(8) if state is None else state

    def law(self, t):
        t = np.asarray(t, dtype=float)
        k = np.searchsorted(self.begins, t, "right") - 1
        q, qd = np.empty((2, len(t), self.ways[0].shape[1]))
        q[k < 0], qd[k < 0] = self.ways[0][0], 0.0
        for i, (law, edges) in enumerate(self.laws):
            now = k == i
            since = np.minimum(t[now] - self.begins[i], edges[-1])
            q[now], qd[now] = law(since)
        return q, qd

    def base(self, t):
        """Poses of the base at ascending times (m, 3), its heading counting turns."""
        edges = [e + b for b, (_, part) in zip(self.begins, self.laws, strict=True) for e in part]
        path = joint_path.path(self.law, edges, [0.0, *t])
        return base_motion.base_poses(self.vector, path, self.state)[1:]

    def tip(self, t, base):
        """Poses of the end effector (m, 3), the base's given."""
        x, y, heading = base.T
        seen = tip_in_base(self.vector, self.law(t)[0])
        away = (seen[:, 0] + 1j * seen[:, 1]) * np.exp(1j * heading)
        turned = np.angle(np.exp(1j * (heading + seen[:, 2])))
        return np.column_stack([x + away.real, y + away.imag, turned])

    def samples(self, rate=100, tip=False):
        """All streams in order of time: joints each in its own phase, all else at `rate`."""
        found = []
        for i in range(1, self.ways[0].shape[1] + 1):
            t = np.arange(0.03 * i, self.length, 0.2)
            q, qd = (part[:, i - 1] for part in self.law(t))
            q = np.round(q / COUNT) * COUNT
            found += [Sample(at(a), i, v) for a, v in zip(t, zip(q, qd, strict=True), strict=True)]
        t = np.arange(0.005, self.length, 1.0 / rate)
        poses = self.base(t)
        fresh = self.rng.standard_normal((10 * len(t) // rate + 1, 3)) * [
            *self.noise[:1] * 2,
            self.noise[1],
        ]
        rates = np.gradient(poses[:, 2], t)
        poses = poses + np.repeat(fresh, rate // 10, axis=0)[: len(t)]
        poses[:, 2] = np.angle(np.exp(1j * poses[:, 2]))
        found += [Sample(at(a), "base", tuple(p)) for a, p in zip(t, poses.tolist(), strict=True)]
        if tip:
            seen = self.tip(t, poses).tolist()
            found += [Sample(at(a), "tip", tuple(p)) for a, p in zip(t, seen, strict=True)]
        found += [Sample(at(a), "gyro", r) for a, r in zip(t, rates.tolist(), strict=True)]
        return sorted(found, key=lambda sample: sample.t)


def telemetry(samples, armed=lambda i, t: True, reference=lambda i, t: (7, 1)):
    """The samples, each of a joint with what its link tells before: armed, start, homings."""
    extra = [
        Sample(s.t, f"link_{s.stream}", (armed(s.stream, s.t), *reference(s.stream, s.t)))
        for s in samples
        if isinstance(s.stream, int)
    ]
    return sorted([*extra, *samples], key=lambda s: s.t)
