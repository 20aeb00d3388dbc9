"""An arm that goes from posture to posture, as its streams of readings and poses."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, JointState

from fss_arm_bags.recorder import Recording
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.segments.excitations import Frame
from fss_arm_calib.segments.rests import BASE, TIP
from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import SECOND, pose_stamped, to_time
from fss_arm_ros.qos import SENSOR

START = 1_700_000_000 * SECOND
ARM = paper_arm()
COUNT = 2 * np.pi / 240_000
POSTURES = np.array([[0.0, 0.1, -0.1, 0.2], [0.5, -0.4, 0.8, -0.2], [-0.7, -0.4, 0.3, 1.0]])
SUBJECTS = {"base": BASE, "tip": TIP}  # in samples of calib_float
TOPICS = {BASE: "vicon/fss/fss", TIP: "vicon/end_effector/end_effector"}


class Sample(NamedTuple):
    t: int  # [ns]
    stream: int | str  # joint number, subject, "base", "tip", "gyro" or "link_<i>"
    value: Any  # q, (q, qd) or Frame; pose; rate; (armed, start of the electronics, homings)


class Rig:
    """An arm that rests at postures for `rest` s, moving for 2 s between, on a drifting base."""

    def __init__(self, postures=POSTURES, rest=4.0, seed=0, noise=0.0, rate=100.0):
        self.postures, self.rest, self.noise = np.asarray(postures), rest, noise
        self.rate = rate
        self.rng = np.random.default_rng(seed)
        self.length = len(postures) * (rest + 2.0)

    def q(self, t):
        """Readings at time t [s], (..., n): rest first, then a smooth move to the next posture."""
        t = np.asarray(t, dtype=float)
        k = np.clip((t // (self.rest + 2.0)).astype(int), 0, len(self.postures) - 1)
        share = np.clip((t - k * (self.rest + 2.0) - self.rest) / 2.0, 0.0, 1.0)
        share = (3.0 * share**2 - 2.0 * share**3)[..., None]
        there = self.postures[np.minimum(k + 1, len(self.postures) - 1)]
        return self.postures[k] + share * (there - self.postures[k])

    def base(self, t):
        t = np.asarray(t, dtype=float)
        return np.stack([0.3 + 0.004 * t, 1.0 - 0.003 * t, 3.13 + 0.002 * t], axis=-1)

    def tip(self, t):
        seen, base = tip_in_base(ARM.vector(), self.q(t)), self.base(t)
        c, s = np.cos(base[..., 2]), np.sin(base[..., 2])
        x = base[..., 0] + c * seen[..., 0] - s * seen[..., 1]
        y = base[..., 1] + s * seen[..., 0] + c * seen[..., 1]
        heading = base[..., 2] + seen[..., 2] + self.rng.normal(size=np.shape(t)) * self.noise
        return np.stack([x, y, np.angle(np.exp(1j * heading))], axis=-1)

    def samples(self, lag=0):
        """All streams: each joint at 5 Hz in its own phase, both subjects at `rate` Hz.

        The end effector's stamps are `lag` ns after the base's.
        """
        found = []
        for i in range(1, 5):
            t = np.arange(0.03 * i, self.length, 0.2)
            q = np.round(self.q(t)[:, i - 1] / COUNT) * COUNT
            found += [Sample(at(a), i, float(b)) for a, b in zip(t, q, strict=True)]
        t = np.arange(0.0, self.length, 1.0 / self.rate)
        for name, late, poses in ((BASE, 0, self.base(t)), (TIP, lag, self.tip(t + lag / SECOND))):
            found += [Sample(at(a) + late, name, tuple(p)) for a, p in zip(t, poses, strict=True)]
        return sorted(found, key=lambda s: s.t)


def at(t: float) -> int:
    """The stamp [ns] of a time [s] since the start."""
    return START + round(t * SECOND)


def message(sample: Sample) -> tuple[str, Any]:
    """A sample's topic and message; occluded poses are zero throughout."""
    t, stream, value = sample
    if isinstance(value, Frame):
        topic, content = f"link_{stream}/telemetry", LinkTelemetry(link=stream)
        for name, number in value._asdict().items():
            setattr(content, name, int(number))
    elif isinstance(stream, int):
        q, qd = value if isinstance(value, tuple) else (value, 0.0)
        topic, content = "joint_states", JointState(name=[f"joint_{stream}"], effort=[0.0])
        content.position, content.velocity = [q], [qd]
    elif stream == "gyro":
        topic, content = "fog/imu", Imu()
        content.angular_velocity.z = value
    elif stream.startswith("link_"):
        topic, content = f"{stream}/telemetry", LinkTelemetry(link=int(stream[5:]))
        content.armed, content.boot, content.homings = value
    else:
        topic = TOPICS[SUBJECTS.get(stream, stream)]
        content = pose_stamped(t, "world", value or (0.0, 0.0, 0.0))
        if value is None:
            content.pose.orientation.w = 0.0
    content.header.stamp = to_time(t)
    return topic, content


def feed(finder: Any, samples: Iterable[Sample], close: bool = True) -> list[Any]:
    """Return what a finder finds in samples in the order given."""
    found = []
    for t, stream, value in samples:
        subject = SUBJECTS.get(stream, stream)
        if subject in TOPICS:
            found += finder.add_pose(subject, t, value)
        elif stream == "gyro":
            found += finder.add_rate(t, value)
        elif isinstance(stream, str):
            found += finder.add_telemetry(int(stream.removeprefix("link_")), t, *value)
        elif isinstance(value, Frame):
            found += finder.add_frame(stream, t, value)
        else:
            reading = value if isinstance(value, tuple) else (value,)
            found += finder.add_reading(stream, t, *reading)
    return found + (finder.close() if close else [])


def without(samples, streams, begin, end):
    """The samples less those of some streams within an interval [s]."""
    return [s for s in samples if s.stream not in streams or not at(begin) < s.t < at(end)]


def frozen(samples, stream, begin, end):
    """The samples with a subject's pose of the time `begin`, with fresh stamps, until `end` [s]."""
    held = next(s.value for s in samples if s.stream == stream and s.t >= at(begin))
    return [
        s._replace(value=held) if s.stream == stream and at(begin) <= s.t < at(end) else s
        for s in samples
    ]


def record(
    folder: Path,
    samples: Iterable[Sample],
    late: Callable[[Sample], int] = lambda _: SECOND // 100,
    renamed: Callable[[str], str] = str,
) -> Path:
    """The samples as a bag, in many chunks, received `late(sample)` ns late, topics `renamed`."""
    bag = Recording(folder)
    for k, sample in enumerate(samples):
        topic, content = message(sample)
        topic, kind = f"/{renamed(topic)}", type(content)
        if topic not in bag.topics:
            bag.add(topic, f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}", [SENSOR])
        if k % 200 == 199:
            bag.flush()
        bag.write(topic, sample.t + late(sample), serialize_message(content))
    bag.close()
    return bag.path


def resting(lag: int = 0) -> list[Sample]:
    """Eight rests that nothing is wrong with, VICON at 25 Hz."""
    return Rig(DEFAULT_POSTURES[:8], rest=3.2, rate=25.0).samples(lag)
