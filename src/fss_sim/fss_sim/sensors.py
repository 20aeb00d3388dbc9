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

from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND
from fss_sim.faults import GyroFaults, SubjectFaults
from fss_sim.noise import Noise
from fss_sim.random_numbers import RandomNumbers, Stream, random_generator
from fss_sim.vicon import BASE, NOT_VISIBLE, TARGET, TIP, MarkerResult, Pose

RATE = 100  # frames of VICON and samples of the FOG per second
MOVING_SPEED = 1e-3  # speed above which a joint is moving [rad/s]
REST_FRAMES = RATE // 5  # number of frames without a moving joint that count as a rest
MAX_LATENCY = RATE  # largest latency of VICON [frames]

NO_SUBJECT_FAULTS, NO_GYRO_FAULTS = SubjectFaults(), GyroFaults()  # no faults


class SubjectReading(NamedTuple):
    """Data that a VICON receiver publishes for a subject."""

    pose: Pose  # in the world frame
    occluded: bool = False  # if True, the pose is invalid
    age: int = 0  # time from the stamp to the frame's end [ns]


class Readings(NamedTuple):
    """Readings of the sensors at one instant; None: no reading."""

    base: SubjectReading | None
    tip: SubjectReading | None  # end effector
    rate: float | None  # angular rate of the base, from the FOG [rad/s]
    target: SubjectReading | None = None


class RandomWalk:
    """Random walk that is 0 at time 0 and has the standard deviation sqrt(t) at time t [s]."""

    def __init__(self, seed: int) -> None:
        self._random = random_generator(seed, Stream.WALK, 0)
        self._values = np.zeros(1)  # values at 0, 1, 2, ... s

    def value(self, frame: int) -> float:
        """Return the value at a frame, interpolated linearly between whole seconds."""
        second, part = divmod(frame, RATE)
        while second + 1 >= len(self._values):
            steps = np.cumsum(self._random.standard_normal(len(self._values)))
            self._values = np.concatenate([self._values, self._values[-1] + steps])
        a, b = self._values[second : second + 2].tolist()
        return float(a + (b - a) * part / RATE)


class SubjectSensor:
    """VICON data of one subject, with latency and faults."""

    def __init__(self, latency: int) -> None:
        self._latency = latency  # [frames]
        self._poses: deque[Pose | None] = deque(maxlen=MAX_LATENCY + 1)
        self._reported: Pose | None = (0.0, 0.0, 0.0)

    def report(
        self,
        pose: Pose | None,
        faults: SubjectFaults,
        dropout_draw: float,
        occlusion_draw: float,
        age: int = 0,
    ) -> SubjectReading | None:
        """Return the published data for a picture with this pose; None: nothing is published.

        Args:
            pose: pose in the world frame; None if the picture does not show the subject.
            faults: present faults of the subject.
            dropout_draw: uniform random number from 0 to 1, which decides about a dropout.
            occlusion_draw: uniform random number from 0 to 1, which decides about an occlusion.
            age: time from the stamp of the pose to the frame's end [ns].
        """
        self._poses.append(pose)
        latency = min(self._latency + round(faults.latency * RATE), len(self._poses) - 1)
        if dropout_draw < faults.dropout:
            return None
        if not faults.frozen:
            delayed = self._poses[-1 - latency]
            self._reported = delayed and (*delayed[:2], delayed[2] + faults.turn)
        occluded = self._reported is None or occlusion_draw < faults.occlusion
        return SubjectReading(self._reported or (0.0, 0.0, 0.0), occluded, age)


class Sensors:
    """VICON and FOG, which observe one frame after another.

    Args:
        noise: sizes of the sensors' errors.
        seed: seed of all errors.
        rests: number of previous rests, if a run is resumed.
    """

    def __init__(self, noise: Noise, seed: int, rests: int = 0) -> None:
        self.noise, self.seed, self.rests = noise, seed, rests
        self._resting_frames = 0
        self._bias, self._scale = random_generator(seed, Stream.RUN, 0).standard_normal(2).tolist()
        self._walk = RandomWalk(seed)
        self._chance, self._white_noise = RandomNumbers(seed, 7), RandomNumbers(seed, 7)
        self.hold = max(1, round(noise.vicon_hold * RATE))  # [frames]
        self._white = np.array([noise.position_noise] * 2 + [noise.heading_noise])
        latency = round(noise.vicon_latency * RATE) + (noise.vicon_jitter > 0.0)
        self._base, self._tip, self._target = (SubjectSensor(latency) for _ in range(3))
        self._target_chance = RandomNumbers(seed, 3, Stream.TARGET)
        self._jitter = RandomNumbers(seed, 1, Stream.JITTER)
        self._draw_rest()

    def observe(
        self,
        frame: int,
        base: Pose,
        tip: Pose,
        rate: float,
        qd: Floats,
        base_faults: SubjectFaults = NO_SUBJECT_FAULTS,
        tip_faults: SubjectFaults = NO_SUBJECT_FAULTS,
        gyro_faults: GyroFaults = NO_GYRO_FAULTS,
        target: Pose | None = None,
        marker_results: Mapping[int, MarkerResult] | None = None,
        target_faults: SubjectFaults = NO_SUBJECT_FAULTS,
    ) -> Readings:
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
            marker_results: VICON's result for each subject, by kind; None: no marker model.
            target_faults: faults of the target's markers.
        """
        self._count_rests(qd)
        noise, chance = self.noise, self._chance.uniform(frame)
        white = self._white_noise.normal(frame // self.hold)
        seen_base = _pose(np.array(base) + self._white * white[:3])
        seen_tip = np.array(compose(base, _pose(np.array(tip) + self._error)))
        seen: list[Pose | None] = [seen_base, _pose(seen_tip + self._white * white[3:6])]
        seen.append(target and self._whiten(frame, target))
        if marker_results:
            seen = [
                _with_marker_error(pose, marker_results.get(kind, NOT_VISIBLE))
                for kind, pose in enumerate(seen)
            ]
        bias = noise.gyro_bias * self._bias + gyro_faults.bias
        bias += noise.gyro_walk * self._walk.value(frame)
        scale = 1.0 + noise.gyro_scale * self._scale
        seen_rate = scale * rate + bias + noise.gyro_noise * float(self._chance.normal(frame)[6])
        as_base = seen[TIP] if chance[5] < base_faults.swap else seen[BASE]
        as_tip = seen[BASE] if chance[6] < tip_faults.swap else seen[TIP]
        dropout_draw, occlusion_draw, swap_draw = self._target_chance.uniform(frame)
        as_target = seen[BASE] if swap_draw < target_faults.swap else seen[TARGET]
        age = self._pose_age(frame)
        return Readings(
            self._base.report(as_base, base_faults, chance[0], chance[1], age),
            self._tip.report(as_tip, tip_faults, chance[2], chance[3], age),
            None if chance[4] < gyro_faults.dropout else seen_rate,
            target
            and self._target.report(as_target, target_faults, dropout_draw, occlusion_draw, age),
        )

    def _whiten(self, frame: int, pose: Pose) -> Pose:
        return _pose(self._white * self._target_chance.normal(frame) + pose)

    def _pose_age(self, frame: int) -> int:
        """Return the time from the stamp of a frame's poses to the frame's end [ns]."""
        if not self.noise.vicon_jitter:
            return 0
        jitter = self.noise.vicon_jitter * abs(float(self._jitter.normal(frame)[0]))
        return round(SECOND * max(1.0 / RATE - jitter, 0.0))

    def _count_rests(self, qd: Floats) -> None:
        """Count rests; a rest ends with the next motion, and then a new error is drawn."""
        if np.abs(qd).max() <= MOVING_SPEED:
            self._resting_frames += 1
            return
        if self._resting_frames >= REST_FRAMES:
            self.rests += 1
            self._draw_rest()
        self._resting_frames = 0

    def _draw_rest(self) -> None:
        noise = self.noise
        deviations = np.array(2 * [noise.rest_position_error] + [noise.rest_heading_error])
        self._error = deviations * random_generator(
            self.seed, Stream.REST, self.rests
        ).standard_normal(3)


def _with_marker_error(pose: Pose | None, result: MarkerResult) -> Pose | None:
    """Return a pose with the errors of its markers; None if the subject is not visible."""
    return (*map(add, pose, result.error),) if pose and result.visible else None


def _pose(values: Floats) -> Pose:
    x, y, heading = values.tolist()
    return x, y, heading


def compose(a: Pose, b: Pose) -> Pose:
    """Return the planar pose `b`, given relative to pose `a`, in the reference frame of `a`."""
    c, s = cos(a[2]), sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]
