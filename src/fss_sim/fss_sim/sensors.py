"""Models of the overhead cameras (VICON) and of the fibre-optic gyro (FOG).

Every error depends only on the seed and on a counter: of frames or of rests. A run can therefore be
resumed at any time, and it is reproducible at any simulation speed.
"""

from collections import deque
from collections.abc import Mapping
from math import cos, sin
from operator import add
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.units import SECOND
from fss_sim.faults import GyroFaults, SubjectFaults
from fss_sim.noise import Noise
from fss_sim.random_numbers import RandomNumbers, Stream, drawn
from fss_sim.vicon import ABSENT, BASE, TARGET, TIP, Look, Pose

RATE = 100  # frames of VICON and samples of the FOG per second
MOVING = 1e-3  # speed above which a joint is moving [rad/s]
REST = RATE // 5  # number of frames without a moving joint that count as a rest
MEMORY = RATE  # largest latency of VICON [frames]

SEEN, HEARD = SubjectFaults(), GyroFaults()  # no faults


class Seen(NamedTuple):
    """Data that a VICON receiver publishes for a subject."""

    pose: Pose  # in the world frame
    occluded: bool = False  # if True, the pose is invalid
    before: int = 0  # time from the stamp to the frame's end [ns]


class Sight(NamedTuple):
    """Readings of the sensors at one instant; None: no reading."""

    base: Seen | None
    tip: Seen | None  # end effector
    rate: float | None  # angular rate of the base, from the FOG [rad/s]
    target: Seen | None = None


class Walk:
    """Random walk that is 0 at time 0 and has the standard deviation sqrt(t) at time t [s]."""

    def __init__(self, seed: int) -> None:
        self._random = drawn(seed, Stream.WALK, 0)
        self._values = np.zeros(1)  # values at 0, 1, 2, ... s

    def at(self, frame: int) -> float:
        """Return the value at a frame, interpolated linearly between whole seconds."""
        second, part = divmod(frame, RATE)
        while second + 1 >= len(self._values):
            steps = np.cumsum(self._random.standard_normal(len(self._values)))
            self._values = np.concatenate([self._values, self._values[-1] + steps])
        a, b = self._values[second : second + 2].tolist()
        return float(a + (b - a) * part / RATE)


class Camera:
    """VICON data of one subject, with latency and faults."""

    def __init__(self, latency: int) -> None:
        self._latency = latency  # [frames]
        self._poses: deque[Pose | None] = deque(maxlen=MEMORY + 1)
        self._reported: Pose | None = (0.0, 0.0, 0.0)

    def report(
        self, pose: Pose | None, faults: SubjectFaults, lost: float, hidden: float, before: int = 0
    ) -> Seen | None:
        """Return the published data for a picture with this pose; None: nothing is published.

        Args:
            pose: pose in the world frame; None if the picture does not show the subject.
            faults: present faults of the subject.
            lost: uniform random number from 0 to 1, which decides about a dropout.
            hidden: uniform random number from 0 to 1, which decides about an occlusion.
            before: time from the stamp of the pose to the frame's end [ns].
        """
        self._poses.append(pose)
        late = min(self._latency + round(faults.latency * RATE), len(self._poses) - 1)
        if lost < faults.dropout:
            return None
        if not faults.frozen:
            then = self._poses[-1 - late]
            self._reported = then and (*then[:2], then[2] + faults.turn)
        occluded = self._reported is None or hidden < faults.occlusion
        return Seen(self._reported or (0.0, 0.0, 0.0), occluded, before)


class Sensors:
    """VICON and FOG, which observe one frame after another.

    Args:
        noise: sizes of the sensors' errors.
        seed: seed of all errors.
        rests: number of previous rests, if a run is resumed.
    """

    def __init__(self, noise: Noise, seed: int, rests: int = 0) -> None:
        self.noise, self.seed, self.rests = noise, seed, rests
        self._still = 0
        self._bias, self._scale = drawn(seed, Stream.RUN, 0).standard_normal(2).tolist()
        self._walk = Walk(seed)
        self._chance, self._held = RandomNumbers(seed, 7), RandomNumbers(seed, 7)
        self.hold = max(1, round(noise.vicon_hold * RATE))  # [frames]
        self._white = np.array([noise.position_noise] * 2 + [noise.heading_noise])
        latency = round(noise.vicon_latency * RATE) + (noise.vicon_jitter > 0.0)
        self._base, self._tip, self._target = Camera(latency), Camera(latency), Camera(latency)
        self._target_chance = RandomNumbers(seed, 3, Stream.TARGET)
        self._late = RandomNumbers(seed, 1, Stream.JITTER)
        self._draw_rest()

    def observe(
        self,
        frame: int,
        base: Pose,
        tip: Pose,
        rate: float,
        qd: npt.NDArray[np.float64],
        base_faults: SubjectFaults = SEEN,
        tip_faults: SubjectFaults = SEEN,
        gyro_faults: GyroFaults = HEARD,
        target: Pose | None = None,
        looks: Mapping[int, Look] | None = None,
        target_faults: SubjectFaults = SEEN,
    ) -> Sight:
        """Return the readings of the sensors in a frame.

        A calibration uses the pose of the end effector relative to the base. The error of this pose
        is exactly the error of the rest, plus the white noise of both poses.

        Args:
            frame: number of the frame, which selects the noise.
            base: true pose of the base in the world frame.
            tip: true pose of the end effector in the base frame.
            rate: true angular velocity of the base [rad/s].
            qd: (n,) joint velocities [rad/s]; the error of a rest is redrawn when the arm moves.
            base_faults: faults of the base's markers.
            tip_faults: faults of the end effector's markers.
            gyro_faults: faults of the FOG.
            target: true pose of the target in the world frame, if there is one.
            looks: result of VICON's picture for each subject, by kind; None: no marker model.
            target_faults: faults of the target's markers.
        """
        self._follow(qd)
        noise, chance = self.noise, self._chance.uniform(frame)
        white = self._held.normal(frame // self.hold)
        seen_base = _pose(np.array(base) + self._white * white[:3])
        seen_tip = np.array(compose(base, _pose(np.array(tip) + self._error)))
        seen: list[Pose | None] = [seen_base, _pose(seen_tip + self._white * white[3:6])]
        seen.append(target and self._whiten(frame, target))
        if looks:
            seen = [_off(pose, looks.get(kind, ABSENT)) for kind, pose in enumerate(seen)]
        bias = noise.gyro_bias * self._bias + gyro_faults.bias
        bias += noise.gyro_walk * self._walk.at(frame)
        scale = 1.0 + noise.gyro_scale * self._scale
        seen_rate = scale * rate + bias + noise.gyro_noise * float(self._chance.normal(frame)[6])
        as_base = seen[TIP] if chance[5] < base_faults.swap else seen[BASE]
        as_tip = seen[BASE] if chance[6] < tip_faults.swap else seen[TIP]
        lost, hidden, taken = self._target_chance.uniform(frame)
        as_target = seen[BASE] if taken < target_faults.swap else seen[TARGET]
        before = self._before(frame)
        return Sight(
            self._base.report(as_base, base_faults, chance[0], chance[1], before),
            self._tip.report(as_tip, tip_faults, chance[2], chance[3], before),
            None if chance[4] < gyro_faults.dropout else seen_rate,
            target and self._target.report(as_target, target_faults, lost, hidden, before),
        )

    def _whiten(self, frame: int, pose: Pose) -> Pose:
        return _pose(self._white * self._target_chance.normal(frame) + pose)

    def _before(self, frame: int) -> int:
        """Return the time from the stamp of a frame's poses to the frame's end [ns]."""
        if not self.noise.vicon_jitter:
            return 0
        late = self.noise.vicon_jitter * abs(float(self._late.normal(frame)[0]))
        return round(SECOND * max(1.0 / RATE - late, 0.0))

    def _follow(self, qd: npt.NDArray[np.float64]) -> None:
        """Count rests; a rest ends with the next motion, and then a new error is drawn."""
        if np.abs(qd).max() <= MOVING:
            self._still += 1
            return
        if self._still >= REST:
            self.rests += 1
            self._draw_rest()
        self._still = 0

    def _draw_rest(self) -> None:
        noise = self.noise
        deviations = np.array(2 * [noise.rest_position_error] + [noise.rest_heading_error])
        self._error = deviations * drawn(self.seed, Stream.REST, self.rests).standard_normal(3)


def _off(pose: Pose | None, look: Look) -> Pose | None:
    """Return a pose with the errors of its markers; None if the subject is not visible."""
    return (*map(add, pose, look.error),) if pose and look.there else None


def _pose(values: npt.NDArray[np.float64]) -> Pose:
    x, y, heading = values.tolist()
    return x, y, heading


def compose(a: Pose, b: Pose) -> Pose:
    """Return the planar pose `b`, given relative to pose `a`, in the reference frame of `a`."""
    c, s = cos(a[2]), sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]
