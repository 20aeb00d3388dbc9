"""What the overhead cameras (VICON) and the fibre-optic gyro (FOG) make of the true motion.

Every error is a function of the seed and of a counter alone, of the frame or of the rest, so that
a run can be resumed anywhere and repeats itself whatever the pace it is computed at.
"""

from collections import deque
from math import cos, sin
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_sim.faults import GyroFaults, SubjectFaults
from fss_sim.noise import Noise

Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]

RATE = 100  # frames of VICON and samples of the FOG a second
MOVING = 1e-3  # a joint faster than this moves [rad/s]
REST = RATE // 5  # frames without a moving joint that make a rest
MEMORY = RATE  # frames that VICON's latency may last
BLOCK = 256  # frames whose random numbers are drawn at once

SEEN, HEARD = SubjectFaults(), GyroFaults()  # nothing is wrong

_FRAME, _REST, _RUN, _CHANCE, _WALK, _TARGET = range(6)  # the streams of random numbers


class Seen(NamedTuple):
    """What a VICON receiver publishes of a subject."""

    pose: Pose  # in the world
    occluded: bool = False  # the pose says nothing


class Sight(NamedTuple):
    """What the sensors report at one instant; None: nothing."""

    base: Seen | None
    tip: Seen | None  # of the end effector
    rate: float | None  # of the base, by the FOG [rad/s]
    target: Seen | None = None


class Chance:
    """Random numbers by frame, `width` of each kind: normal and uniform ones."""

    def __init__(self, seed: int, width: int, stream: int = _FRAME) -> None:
        self._seed, self._width, self._stream = seed, width, stream
        self._block = -1
        self._normal = self._uniform = np.empty((0, 0))

    def normal(self, frame: int) -> npt.NDArray[np.float64]:
        """(width,) of mean 0 and deviation 1."""
        self._draw(frame // BLOCK)
        row: npt.NDArray[np.float64] = self._normal[frame % BLOCK]
        return row

    def uniform(self, frame: int) -> list[float]:
        """(width,) from 0 to 1."""
        self._draw(frame // BLOCK)
        row: list[float] = self._uniform[frame % BLOCK].tolist()
        return row

    def _draw(self, block: int) -> None:
        if block != self._block:
            size = BLOCK, self._width
            self._block = block
            self._normal = _random(self._seed, self._stream, block).standard_normal(size)
            self._uniform = _random(self._seed, _CHANCE, block).random(size)


class Walk:
    """A random walk that is 0 at time 0 and has the deviation sqrt(t) at time t [s]."""

    def __init__(self, seed: int) -> None:
        self._random = _random(seed, _WALK, 0)
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
        self._poses: deque[Pose] = deque(maxlen=MEMORY + 1)
        self._reported = (0.0, 0.0, 0.0)

    def report(self, pose: Pose, faults: SubjectFaults, lost: float, hidden: float) -> Seen | None:
        """What comes of a picture; `lost` and `hidden`, from 0 to 1, are its chances."""
        self._poses.append(pose)
        late = min(self._latency + round(faults.latency * RATE), len(self._poses) - 1)
        if lost < faults.dropout:
            return None
        if not faults.frozen:
            x, y, heading = self._poses[-1 - late]
            self._reported = x, y, heading + faults.turn
        return Seen(self._reported, occluded=hidden < faults.occlusion)


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
        self._bias, self._scale = _random(seed, _RUN, 0).standard_normal(2).tolist()
        self._walk = Walk(seed)
        self._chance, self._held = Chance(seed, 7), Chance(seed, 7)
        self._hold = max(1, round(noise.vicon_hold * RATE))  # [frames]
        self._white = np.array([noise.position_noise] * 2 + [noise.heading_noise])
        latency = round(noise.vicon_latency * RATE)
        self._base, self._tip, self._target = Camera(latency), Camera(latency), Camera(latency)
        self._target_chance = Chance(seed, 3, _TARGET)
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
        """
        self._follow(qd)
        noise, chance = self.noise, self._chance.uniform(frame)
        white = self._held.normal(frame // self._hold)
        seen_base = (np.array(base) + self._white * white[:3]).tolist()
        seen_tip = np.array(compose(base, (np.array(tip) + self._error).tolist()))
        seen_tip = (seen_tip + self._white * white[3:6]).tolist()
        bias = noise.gyro_bias * self._bias + gyro_faults.bias
        bias += noise.gyro_walk * self._walk.at(frame)
        scale = 1.0 + noise.gyro_scale * self._scale
        seen_rate = scale * rate + bias + noise.gyro_noise * float(self._chance.normal(frame)[6])
        as_base = seen_tip if chance[5] < base_faults.swap else seen_base
        as_tip = seen_base if chance[6] < tip_faults.swap else seen_tip
        return Sight(
            self._base.report(tuple(as_base), base_faults, *chance[:2]),
            self._tip.report(tuple(as_tip), tip_faults, *chance[2:4]),
            None if chance[4] < gyro_faults.dropout else seen_rate,
            target and self._see_target(frame, target),
        )

    def _see_target(self, frame: int, pose: Pose) -> Seen | None:
        x, y, heading = (self._white * self._target_chance.normal(frame) + pose).tolist()
        return self._target.report((x, y, heading), SEEN, 1.0, 1.0)

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
        self._error = deviations * _random(self.seed, _REST, self.rests).standard_normal(3)


def _random(seed: int, stream: int, counter: int) -> np.random.Generator:
    return np.random.default_rng((seed, stream, counter))


def compose(a: Pose, b: Pose) -> Pose:
    """The planar pose `b`, given in the frame of pose `a`, in the frame that `a` is given in."""
    c, s = cos(a[2]), sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]
