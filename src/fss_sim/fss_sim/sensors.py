"""What the overhead cameras (VICON) and the fibre-optic gyro (FOG) make of the true motion.

Every error is a function of the seed and of a counter alone, of the frame or of the rest, so that
a run can be resumed anywhere and repeats itself whatever the pace it is computed at.
"""

from dataclasses import dataclass
from math import cos, radians, sin
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]

RATE = 100  # frames of VICON and samples of the FOG a second
MOVING = 1e-3  # a joint faster than this moves [rad/s]
REST = RATE // 5  # frames without a moving joint that make a rest

_FRAME, _REST, _RUN = range(3)  # the streams of random numbers


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the sensors' errors; none by default."""

    position_noise: float = 0.0  # white, each VICON pose and axis [m]
    heading_noise: float = 0.0  # white, each VICON pose [rad]
    rest_position_error: float = 0.0  # end effector seen from the base, each axis, for a rest [m]
    rest_heading_error: float = 0.0  # likewise [rad]
    gyro_noise: float = 0.0  # white, each sample [rad/s]
    gyro_bias: float = 0.0  # for the run [rad/s]


#: `paper`: the errors of a rest that give the residuals of Sec. 4.1, 0.015 m and 0.683 degrees.
PRESETS = {
    "ideal": Noise(),
    "default": Noise(
        position_noise=0.0003,
        heading_noise=radians(0.05),
        rest_position_error=0.001,
        rest_heading_error=radians(0.1),
        gyro_noise=radians(0.01),
        gyro_bias=radians(0.003),
    ),
    "paper": Noise(
        position_noise=0.0003,
        heading_noise=radians(0.05),
        rest_position_error=0.0177,
        rest_heading_error=radians(0.715),
        gyro_noise=radians(0.01),
        gyro_bias=radians(0.003),
    ),
}


class Sight(NamedTuple):
    """What the sensors report at one instant."""

    base: Pose  # in the world
    tip: Pose  # of the end effector, in the world
    rate: float  # of the base, by the FOG [rad/s]


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
        self._gyro_bias = noise.gyro_bias * self._normal(_RUN, 0, 1)[0]
        self._draw_rest()

    def look(
        self, frame: int, base: Pose, tip: Pose, rate: float, qd: npt.NDArray[np.float64]
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
        """
        self._follow(qd)
        noise = self.noise
        white = self._normal(_FRAME, frame, 7)
        deviations = np.array(2 * [noise.position_noise] + [noise.heading_noise])
        seen_base = np.array(base) + deviations * white[:3]
        seen_tip = np.array(compose(base, (np.array(tip) + self._error).tolist()))
        seen_tip += deviations * white[3:6]
        seen_rate = rate + self._gyro_bias + noise.gyro_noise * white[6]
        return Sight(tuple(seen_base.tolist()), tuple(seen_tip.tolist()), float(seen_rate))

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
        self._error = deviations * self._normal(_REST, self.rests, 3)

    def _normal(self, stream: int, counter: int, size: int) -> npt.NDArray[np.float64]:
        return np.random.default_rng((self.seed, stream, counter)).standard_normal(size)


def compose(a: Pose, b: Pose) -> Pose:
    """The planar pose `b`, given in the frame of pose `a`, in the frame that `a` is given in."""
    c, s = cos(a[2]), sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]
