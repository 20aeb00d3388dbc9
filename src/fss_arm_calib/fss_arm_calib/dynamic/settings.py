"""The settings of a dynamic calibration, live, replayed and offline alike."""

from dataclasses import dataclass
from math import inf, radians

from fss_arm_calib.dynamic.parameters import Choice, Knowledge
from fss_arm_calib.kinematic.problem import CAUCHY, HUBER, LOSSES, SQUARE
from fss_arm_calib.kinematic.settings import RestSettings
from fss_arm_model.settings import setting

POSE, HEADING = "pose", "heading"

GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True)
class ManeuverSettings(RestSettings):
    """What counts as a maneuver.

    Raises:
        ValueError: a setting is impossible.
    """

    longest: float = setting(
        2.0, "longest look at the base before a maneuver, and after it; half a rest at most [s]"
    )
    joint_gap: float = setting(0.5, "silence of a joint that spoils a maneuver [s]")
    horizon: float = setting(
        60.0, "how far streams may lag each other, and how long a maneuver may last [s]"
    )
    kept: int = setting(100, "most maneuvers used for a result, the newest; older ones go")
    bin: float = setting(0.5, "poses of a look are averaged over so long each [s]")
    least_travel: float = setting(0.05, "a smaller motion is no maneuver [rad]")
    time_offset: float = setting(
        0.0,
        "of the joints' and the gyro's stamps against motion capture's, about; what the gyro tells "
        "of it takes its place [s]",
    )
    max_base_turn: float = setting(
        3.0, "the base turns no faster; what it may turn by unseen, the gyro must tell [rad/s]"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("bin", "least_travel", "max_base_turn"):
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        if not abs(self.time_offset) < self.horizon:
            raise ValueError(
                f"time_offset is {self.time_offset} s, must be within {self.horizon} s"
            )


@dataclass(frozen=True)
class DynamicCriteria:
    """What a dynamic calibration must meet to pass.

    Raises:
        ValueError: a criterion is impossible.
    """

    min_maneuvers: int = setting(6, "fewest maneuvers to judge by")
    min_probability: float = setting(
        1e-3, "least chi-square probability of residuals as large as found"
    )
    outlier: float = setting(
        3.0, "largest error of a maneuver predicted from the others, in its deviations"
    )
    max_outliers: int = setting(0, "most outliers to reject; with more, the calibration fails")
    max_tip_error: float = setting(
        0.03,
        "largest distance of the end effector from where the description puts it, root mean square "
        "[m]",
    )
    max_relative: float = setting(
        1.0, "largest deviation of a mass or an inertia, of its value in the description"
    )
    max_place: float = setting(0.02, "largest deviation of a length or a centre of mass [m]")

    def __post_init__(self) -> None:
        for name in ("min_maneuvers", "outlier", "max_tip_error", "max_relative", "max_place"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        if self.max_outliers < 0:
            raise ValueError(f"max_outliers is {self.max_outliers}, must not be negative")
        if not 0.0 <= self.min_probability < 1.0:
            raise ValueError(f"min_probability is {self.min_probability}, must be in [0, 1)")


@dataclass(frozen=True)
class DynamicCalibrationSettings(ManeuverSettings, DynamicCriteria, Knowledge):
    """Where the data come from, what is known beforehand, what is estimated and how it is judged.

    Raises:
        ValueError: a setting is impossible.
    """

    arm: str = setting("", "description YAML to begin from; empty: the paper's arm")
    estimate: str = setting(
        "b_i I_i I_0 com_0",
        "what to estimate, in words: b_i: of each link; I: one that all share; I_0 com_0 m_0: of "
        "the base; also m_i, a_i, theta_0_i, mount, or a name as b_2",
    )
    priors: str = setting(
        "m_i m_0 I_0 com_0 a_i theta_0_i mount",
        "words of `estimate` for which the description's value counts as an observation",
    )
    residuals: str = setting(POSE, f"{POSE}: the base's whole pose; {HEADING}: as the paper's")
    loss: str = setting(
        SQUARE, f"{SQUARE}, or {HUBER} or {CAUCHY}, which let maneuvers far off count less"
    )
    position_deviation: float = setting(0.001, "of a pose of the base, each axis, 1 sigma [m]")
    heading_deviation: float = setting(radians(0.5), "likewise its heading [rad]")
    fresh_rate: float = setting(
        10.0, "how often a pose's error is another one: averaging helps by so many a second [1/s]"
    )
    momentum_deviation: float = setting(
        1.0, "of the momentum at the start of a maneuver, about 0; 0: at rest [N s]"
    )
    spin_deviation: float = setting(0.5, "likewise the angular momentum [N m s]")
    tilt_deviation: float = setting(
        radians(0.02), "of the table's tilt, about 0, each axis; 0: level [rad]"
    )
    joints_topic: str = setting("joint_states", "readings of joint_1 .. joint_n")
    base_topic: str = setting("vicon/fss/fss", "poses of the base")
    tip_topic: str = setting("vicon/end_effector/end_effector", "poses of the end effector")
    gyro_topic: str = setting("fog/imu", "turn rates of the base")

    def __post_init__(self) -> None:
        ManeuverSettings.__post_init__(self)
        DynamicCriteria.__post_init__(self)
        Knowledge.__post_init__(self)
        if self.residuals not in (POSE, HEADING):
            raise ValueError(f"residuals is {self.residuals!r}, expected {POSE!r} or {HEADING!r}")
        if self.loss not in LOSSES:
            raise ValueError(f"loss is {self.loss!r}, expected one of {', '.join(LOSSES)}")
        for name in ("position_deviation", "heading_deviation", "fresh_rate"):
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        for name in ("momentum_deviation", "spin_deviation", "tilt_deviation"):
            if not 0.0 <= getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must not be negative")
        Choice.of(self.estimate, 12)
        deviations = self.deviations(12)
        for word in self.estimate.split():
            if not (Choice.of(word, 12).basis.T @ deviations > 0.0).all():
                raise ValueError(
                    f"estimate has {word!r}, said to be known exactly (its deviation is 0): "
                    "leave it out"
                )
        if self.priors.strip():
            Choice.of(self.priors, 12)
