"""Sizes of the errors of all instruments."""

from dataclasses import dataclass, replace
from math import radians
from typing import Any

from fss_arm_model.settings import NOT_NEGATIVE, Check, Settings, between, setting


def error(about: str, unit: str = "", check: Check = NOT_NEGATIVE) -> Any:
    """Return a field of Noise; 0 means no error."""
    return setting(0.0, about, unit=unit, check=check)


@dataclass(frozen=True)
class Noise(Settings):
    """Sizes of the errors of the instruments; no errors by default."""

    position_noise: float = error("white noise of a VICON pose, each axis, 1 sigma", "m")
    heading_noise: float = error("white noise of a VICON pose's heading, 1 sigma", "rad")
    vicon_hold: float = error("time for which a sample of a VICON pose's noise is kept", "s")
    rest_position_error: float = error(
        "error of the tip's measured position in the base frame, constant in a rest, 1 sigma",
        "m",
    )
    rest_heading_error: float = error(
        "error of the tip's measured heading in the base frame, constant in a rest, 1 sigma",
        "rad",
    )
    vicon_latency: float = error(
        "time by which a VICON pose is older than its stamp", "s", check=between(0.0, 1.0)
    )
    vicon_jitter: float = error(
        "random further lag of the stamps behind the VICON poses, half normal, 1 sigma",
        "s",
        check=between(0.0, 0.003),
    )
    marker_noise: float = error(
        "white noise of a VICON marker, each axis, 1 sigma; set position_noise to 0 with it", "m"
    )
    vicon_edge_error: float = error(
        "measured displacement of VICON markers at the middle of the table's edge; it grows with "
        "the cube of the distance from the table's middle",
        "m",
    )
    vicon_occlusion: float = error(
        "1: bodies hide VICON's markers from the cameras, 0: they do not", check=between(0.0, 1.0)
    )
    vicon_merge_distance: float = error(
        "distance below which VICON merges markers of two subjects and loses both", "m"
    )
    vicon_merge_swap: float = error(
        "probability that VICON swaps two subjects when their markers merge",
        check=between(0.0, 1.0),
    )
    gyro_noise: float = error("white noise of a gyro sample, 1 sigma", "rad/s")
    gyro_bias: float = error("constant bias of the FOG in a run, 1 sigma", "rad/s")
    gyro_walk: float = error("random walk of the gyro's bias, 1 sigma", "rad/s/sqrt(s)")
    gyro_scale: float = error("relative scale error of the FOG in a run, 1 sigma")
    encoder_error: float = error(
        "amplitude of the encoder's error with two periods per turn of the motor",
        "rad",
        check=between(0.0, 0.01),
    )
    encoder_eccentricity: float = error(
        "largest error caused by the eccentricity of encoder and gear, one period per turn of the "
        "joint",
        "rad",
        check=between(0.0, 0.01),
    )
    torque_noise: float = error("white noise of a torque sample, 1 sigma", "N m")
    torque_zero: float = error("zero offset of a torque sensor in a run, 1 sigma", "N m")
    torque_crosstalk: float = error(
        "torque that a torque sensor measures per force across its link, 1 sigma", "N m/N"
    )
    torque_drift: float = error(
        "change of a torque sensor's zero as its link warms up, 1 sigma", "N m"
    )
    clock_drift: float = error("relative drift of a link's clock, 1 sigma")

    @property
    def markers(self) -> bool:
        """Return True if VICON's poses are computed from single markers."""
        each = self.marker_noise, self.vicon_edge_error, self.vicon_merge_distance
        return any(each) or self.vicon_occlusion > 0.0


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

#: VICON errors of `laboratory`: markers with errors, in place of poses with white noise.
#: A noise of 0.2 to 0.3 mm is usual for markers in motion; the other values are assumptions.
VICON = {
    "position_noise": 0.0,
    "heading_noise": 0.0,
    "marker_noise": 0.0003,
    "vicon_edge_error": 0.001,
    "vicon_latency": 0.01,
    "vicon_jitter": 0.001,
    "vicon_occlusion": 1.0,
    "vicon_merge_distance": 0.025,
    "vicon_merge_swap": 0.3,
}

#: `paper`: errors of each rest that give the residuals of Sec. 4.1, 0.015 m and 0.683 degrees.
#: `laboratory`: used with the realistic joints of plant/joints.py.
PRESETS = {
    "ideal": Noise(),
    "default": _DEFAULT,
    "paper": replace(_DEFAULT, rest_position_error=0.0177, rest_heading_error=radians(0.715)),
    "laboratory": replace(
        _DEFAULT,
        encoder_eccentricity=radians(60 / 3600),
        torque_crosstalk=0.002,
        torque_drift=0.02,
        **VICON,
    ),
}
