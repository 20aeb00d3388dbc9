"""What the overhead cameras (VICON) and the fibre-optic gyro (FOG) make of the true motion.

Every error is a function of the seed and of a counter alone, of the frame or of the rest, so that
a run can be resumed anywhere and repeats itself whatever the pace it is computed at.
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

RATE = 100  # frames of VICON and samples of the FOG a second
MOVING = 1e-3  # a joint faster than this moves [rad/s]
REST = RATE // 5  # frames without a moving joint that make a rest
MEMORY = RATE  # frames that VICON's latency may last

SEEN, HEARD = SubjectFaults(), GyroFaults()  # nothing is wrong


class Seen(NamedTuple):
    """What a VICON receiver publishes of a subject."""

    pose: Pose  # in the world
    occluded: bool = False  # the pose says nothing
    before: int = 0  # the frame's end it is stamped [ns]


class Sight(NamedTuple):
    """What the sensors report at one instant; None: nothing."""

    base: Seen | None
    tip: Seen | None  # of the end effector
    rate: float | None  # of the base, by the FOG [rad/s]
    target: Seen | None = None


class Walk:
    """A random walk that is 0 at time 0 and has the deviation sqrt(t) at time t [s]."""

    def __init__(self, seed: int) -> None:
        self._random = drawn(seed, Stream.WALK, 0)
        self._values = np.zeros(1)  # at 0, 1, 2, ... s

    def at(self, frame: int) -> float:
        """Its value at a frame; straight from one second to the next."""
        second, part = divmod(frame, RATE)
        while second + 1 >= len(self._values):
            steps = np.cumsum(self._random.standard_normal(len(self._values)))
            self._values = np.concatenate([self._values, self._values[-1] + steps])
        a, b = self._values[second : second + 2].tolist()
        return float(a + (b - a) * part / RATE)


class Camera:
    """One subject as VICON reports it, late and with its faults."""

    def __init__(self, latency: int) -> None:
        self._latency = latency  # [frames]
        self._poses: deque[Pose | None] = deque(maxlen=MEMORY + 1)
        self._reported: Pose | None = (0.0, 0.0, 0.0)

    def report(
        self, pose: Pose | None, faults: SubjectFaults, lost: float, hidden: float, before: int = 0
    ) -> Seen | None:
        """What comes of a picture that has this pose, None: it has none.

        Args:
            pose: in the world.
            faults: in force.
            lost: chance, from 0 to 1, against which a dropout is held.
            hidden: the same of an occlusion.
            before: how much before the frame's end the pose is stamped [ns].
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
    """VICON and FOG, looking at one frame after the other.

    Args:
        noise: the sensors' errors.
        seed: of all of them.
        rests: how many rests there were before, when a run is resumed.
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
        """What is seen in a frame.

        The end effector seen from the base, which is what a calibration observes, is off by
        exactly the error of the rest; white noise of either pose comes on top.

        Args:
            frame: its number, which selects the noise.
            base: true pose of the base in the world.
            tip: true pose of the end effector in the frame of the base.
            rate: true angular velocity of the base [rad/s].
            qd: (n,) joint velocities [rad/s]; the error of a rest is redrawn when they leave 0.
            base_faults: what is wrong with the base's markers.
            tip_faults: what is wrong with the end effector's markers.
            gyro_faults: what is wrong with the FOG.
            target: true pose of the target in the world, if there is one.
            looks: what VICON's picture gives of each subject, by kind; nothing: no single markers.
            target_faults: what is wrong with the target's markers.
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
        """How much before a frame's end its poses are stamped [ns]."""
        if not self.noise.vicon_jitter:
            return 0
        late = self.noise.vicon_jitter * abs(float(self._late.normal(frame)[0]))
        return round(SECOND * max(1.0 / RATE - late, 0.0))

    def _follow(self, qd: npt.NDArray[np.float64]) -> None:
        """Count rests: one ends with the first motion after it, which redraws its error."""
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
    """A pose with the markers' errors; None of what is lost."""
    return (*map(add, pose, look.error),) if pose and look.there else None


def _pose(values: npt.NDArray[np.float64]) -> Pose:
    x, y, heading = values.tolist()
    return x, y, heading


def compose(a: Pose, b: Pose) -> Pose:
    """The planar pose `b`, given in the frame of pose `a`, in the frame that `a` is given in."""
    c, s = cos(a[2]), sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]
