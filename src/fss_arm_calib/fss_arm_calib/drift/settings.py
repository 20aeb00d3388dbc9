"""The settings of what a float tells, live, replayed and offline alike."""

from dataclasses import dataclass
from math import inf, radians

from fss_arm_calib.kinematic.settings import RestSettings
from fss_arm_model.settings import setting


@dataclass(frozen=True)
class DriftSettings(RestSettings):
    """What counts as a drift, what is known beforehand, and when to believe the result.

    Raises:
        ValueError: a setting is impossible.
    """

    arm: str = setting("", "description YAML of masses and inertias; empty: the paper's arm")
    shortest: float = setting(20.0, "a shorter rest of the arm is no drift [s]")
    longest: float = setting(120.0, "a longer one is taken as several [s]")
    kept: int = setting(30, "most drifts that a result is from, the newest; older ones go")
    bin: float = setting(0.5, "poses are averaged over so long each [s]")
    position_deviation: float = setting(0.001, "of a pose of the base, each axis, 1 sigma [m]")
    heading_deviation: float = setting(radians(0.5), "likewise its heading [rad]")
    fresh_rate: float = setting(
        10.0, "how often a pose's error is another one: averaging helps by so many a second [1/s]"
    )
    torque_deviation: float = setting(0.05, "of the hose's torque at rest, about 0 [N m]")
    twist_deviation: float = setting(
        0.01, "of its resistance to turning, about 0; 0: there is none [N m s]"
    )
    drag_deviation: float = setting(0.05, "and to moving, likewise [N s/m]")
    com_deviation: float = setting(0.01, "of the centre of mass, base and arm, each axis [m]")
    mass_deviation: float = setting(0.05, "of mass and inertia of base and arm, relative")
    least_time: float = setting(60.0, "to judge by, all drifts together [s]")
    min_probability: float = setting(
        1e-3, "least chi-square probability of residuals as large as found"
    )
    max_tilt: float = setting(radians(0.001), "largest deviation of the table's tilt [rad]")
    max_torque: float = setting(1e-3, "largest deviation of the hose's mean torque [N m]")
    joints_topic: str = setting("joint_states", "readings of joint_1 .. joint_n")
    base_topic: str = setting("vicon/fss/fss", "poses of the base")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (
            "bin", "position_deviation", "heading_deviation", "fresh_rate", "least_time",
            "max_tilt", "max_torque",
        ):  # fmt: skip
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        for name in (
            "torque_deviation", "twist_deviation", "drag_deviation", "com_deviation",
            "mass_deviation",
        ):  # fmt: skip
            if not 0.0 <= getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must not be negative")
        if not 0.0 <= self.min_probability < 1.0:
            raise ValueError(f"min_probability is {self.min_probability}, must be in [0, 1)")
