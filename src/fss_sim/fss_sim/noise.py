"""How large the errors of all instruments are."""

from dataclasses import dataclass, replace
from math import radians


@dataclass(frozen=True)
class Noise:
    """Errors of the instruments, 1 sigma unless said otherwise; none by default."""

    position_noise: float = 0.0  # white, each VICON pose and axis [m]
    heading_noise: float = 0.0  # white, each VICON pose [rad]
    vicon_hold: float = 0.0  # how long such an error stays before it is another one [s]
    rest_position_error: float = 0.0  # end effector seen from the base, each axis, for a rest [m]
    rest_heading_error: float = 0.0  # likewise [rad]
    vicon_latency: float = 0.0  # from the picture to the stamp that receivers give it, always [s]
    gyro_noise: float = 0.0  # white, each sample of the FOG [rad/s]
    gyro_bias: float = 0.0  # for the run [rad/s]
    gyro_walk: float = 0.0  # of the bias [rad/s after 1 s]
    gyro_scale: float = 0.0  # relative, for the run
    encoder_error: float = 0.0  # largest, of a joint's angle [rad]
    torque_noise: float = 0.0  # white, each sample of a torque converter [N m]
    torque_zero: float = 0.0  # for the run [N m]
    clock_drift: float = 0.0  # of a link's clock, relative, for each of its starts


_DEFAULT = Noise(
    position_noise=0.0003,
    heading_noise=radians(0.05),
    rest_position_error=0.001,
    rest_heading_error=radians(0.1),
    gyro_noise=radians(0.01),
    gyro_bias=radians(0.003),
    gyro_walk=radians(2e-5),
    gyro_scale=5e-4,
    encoder_error=radians(150 / 3600),
    torque_noise=0.002,
    torque_zero=0.02,
    clock_drift=2e-5,
)

#: `paper`: the errors of a rest that give the residuals of Sec. 4.1, 0.015 m and 0.683 degrees.
PRESETS = {
    "ideal": Noise(),
    "default": _DEFAULT,
    "paper": replace(_DEFAULT, rest_position_error=0.0177, rest_heading_error=radians(0.715)),
}
