"""Settings of the filters: errors of sensors and inputs."""

from dataclasses import dataclass

from fss_arm_model.held import Target
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, between, like, setting
from fss_arm_model.vehicle import Vehicle

from .mass_estimator import MassErrors


@dataclass(frozen=True)
class SensorErrors(Settings):
    """Errors of a body's sensors and its accelerations, each as a standard deviation."""

    position_error: float = setting(
        0.001,
        '1 sigma of a measured position, each axis; with `navigation`, increase it if "NIS of '
        'poses" in its diagnostics is far above the expected 3',
        unit="m",
        check=POSITIVE,
    )
    heading_error: float = setting(
        0.009,
        '1 sigma of a measured heading; with `navigation`, increase it if "NIS of poses" in its '
        "diagnostics is far above the expected 3",
        unit="rad",
        check=POSITIVE,
    )
    volume_error: float = setting(
        0.0,
        "error of motion capture that averaging does not reduce, each axis, 1 sigma; added to the "
        "covariance",
        unit="m",
        check=NOT_NEGATIVE,
    )
    volume_heading_error: float = setting(
        0.0,
        "heading error of motion capture that averaging does not reduce, 1 sigma",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    rate_error: float = setting(0.001, "1 sigma of a rate on fog/imu", unit="rad/s", check=POSITIVE)
    bias_walk: float = setting(
        1e-5, "random walk of the gyro's bias, 1 sigma", unit="rad/s/sqrt(s)", check=POSITIVE
    )
    acceleration: float = setting(
        0.05,
        "random walk of the base's velocity by unknown accelerations, 1 sigma",
        unit="m/s/sqrt(s)",
        check=POSITIVE,
    )
    angular_acceleration: float = setting(
        0.3,
        "random walk of the base's turn rate by unknown torques, 1 sigma",
        unit="rad/s/sqrt(s)",
        check=POSITIVE,
    )
    kick: float = setting(
        0.05,
        "1 sigma of a sudden change of the base's speed, as by a grip; assumed only if a "
        "measurement does not fit without it",
        unit="m/s",
        check=NOT_NEGATIVE,
    )
    angular_kick: float = setting(
        0.01,
        "1 sigma of a sudden change of the base's turn rate; assumed only if a measurement does "
        "not fit without it",
        unit="rad/s",
        check=NOT_NEGATIVE,
    )
    settle_time: float = setting(
        0.3,
        "time for which rejected poses must agree until the filter restarts from them",
        unit="s",
        check=POSITIVE,
    )


@dataclass(frozen=True)
class Bounds(Settings):
    """Bounds beyond which the state of a body counts as unknown."""

    max_outage: float = setting(
        2.0,
        "time without a pose after which the state of a body counts as unknown",
        unit="s",
        check=POSITIVE,
    )
    max_position_deviation: float = setting(
        0.02,
        "standard deviation of the position above which the state counts as unknown",
        unit="m",
        check=POSITIVE,
    )
    max_heading_deviation: float = setting(
        0.03,
        "standard deviation of the heading above which the state counts as unknown",
        unit="rad",
        check=POSITIVE,
    )
    max_speed_deviation: float = setting(
        0.05,
        "standard deviation of the speed above which the state counts as unknown",
        unit="m/s",
        check=POSITIVE,
    )


@dataclass(frozen=True)
class TargetErrors(SensorErrors):
    """Errors of a freely floating target: only the table's slope accelerates it."""

    position_error: float = like(SensorErrors, "position_error", 0.0003)
    heading_error: float = like(SensorErrors, "heading_error", 8.7e-4)
    acceleration: float = like(SensorErrors, "acceleration", 5e-4)
    angular_acceleration: float = like(SensorErrors, "angular_acceleration", 5e-4)


@dataclass(frozen=True)
class EstimatorSettings(SensorErrors, Bounds):
    """Errors of the base's sensors and of its known acceleration."""

    position_error: float = like(SensorErrors, "position_error", 0.0003)
    heading_error: float = like(SensorErrors, "heading_error", 8.7e-4)
    rate_error: float = like(SensorErrors, "rate_error", 1.75e-4)
    acceleration: float = like(SensorErrors, "acceleration", 0.001)
    angular_acceleration: float = like(SensorErrors, "angular_acceleration", 0.003)
    thrust: float = setting(0.16, "thrust of one thruster", unit="N", check=POSITIVE)
    thruster_lever: float = setting(
        0.11,
        "lever of a thruster: from the base's origin to the line of thrust; same value as "
        "lever of `guidance` and `base`",
        unit="m",
        check=POSITIVE,
    )
    valve_delay: float = setting(
        0.005,
        "delay from a command to a thruster until its thrust starts, or ends",
        unit="s",
        check=NOT_NEGATIVE,
    )
    thrust_error: float = setting(
        0.05, "relative error of the thrust, 1 sigma", check=between(0.0, 1.0)
    )
    joint_rate_error: float = setting(
        0.04,
        "relative error of a joint's rate, as by the ripple of a harmonic drive, 1 sigma",
        check=between(0.0, 1.0),
    )


@dataclass(frozen=True)
class NavigationSettings(EstimatorSettings, MassErrors):
    """Parameters of a NavigationNode."""

    latency: float = setting(
        0.0,
        "delay of poses' stamps after the exposure, subtracted; 0 if `latency` of mocap is set",
        unit="s",
        check=between(0.0, 0.5),
    )
    target_acceleration: float = setting(
        5e-4,
        "random walk of the target's velocity by unknown accelerations, 1 sigma",
        unit="m/s/sqrt(s)",
        check=POSITIVE,
    )
    target_angular_acceleration: float = setting(
        5e-4,
        "random walk of the target's turn rate by unknown torques, 1 sigma",
        unit="rad/s/sqrt(s)",
        check=POSITIVE,
    )
    target_mass: float = like(Target, "mass")
    target_inertia: float = like(Target, "inertia")
    rate: float = setting(
        20.0,
        "rate of base/state and target/state while no poses arrive",
        unit="Hz",
        check=between(1.0, 100.0),
    )
    arm: str = setting(
        "",
        "arm until a calibration passes: file or built in (paper, cad, truth); empty: paper",
    )
    base_topic: str = like(Vehicle, "base_topic")
    target_topic: str = like(Vehicle, "target_topic")
    world_frame: str = setting("world", "frame id of the published poses")
    base_frame: str = like(Vehicle, "base_frame")
    frame_prefix: str = like(Vehicle, "frame_prefix")
    target_frame: str = setting("target", "child frame id of target/state")

    def target_errors(self) -> TargetErrors:
        """Return the errors of the target: those of the base's poses, and its own process noise."""
        return TargetErrors(
            position_error=self.position_error,
            heading_error=self.heading_error,
            volume_error=self.volume_error,
            volume_heading_error=self.volume_heading_error,
            acceleration=self.target_acceleration,
            angular_acceleration=self.target_angular_acceleration,
        )

    def assumed_body(self) -> Target:
        """Return the target with its assumed mass and inertia."""
        return Target(mass=self.target_mass, inertia=self.target_inertia)
