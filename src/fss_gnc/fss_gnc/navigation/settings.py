"""What the filter knows of the base and its sensors."""

from dataclasses import dataclass

from fss_arm_model.settings import POSITIVE, Settings, setting


@dataclass(frozen=True)
class SensorErrors(Settings):
    """Errors of the base's sensors and its accelerations, each as a standard deviation."""

    position_error: float = setting(
        0.001,
        "standard deviation of the base's measured position along each axis",
        unit="m",
        check=POSITIVE,
    )
    heading_error: float = setting(
        0.009, "standard deviation of the base's measured heading", unit="rad", check=POSITIVE
    )
    rate_error: float = setting(
        0.001, "standard deviation of a gyro sample", unit="rad/s", check=POSITIVE
    )
    bias_walk: float = setting(
        1e-5, "random walk of the gyro's bias", unit="rad/s/sqrt(s)", check=POSITIVE
    )
    acceleration: float = setting(
        0.05, "random walk of the base's velocity", unit="m/s/sqrt(s)", check=POSITIVE
    )
    angular_acceleration: float = setting(
        0.3, "random walk of the base's turn rate", unit="rad/s/sqrt(s)", check=POSITIVE
    )
