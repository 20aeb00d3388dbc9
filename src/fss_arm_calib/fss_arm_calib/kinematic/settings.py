"""What live, replayed and offline calibrations must agree on, each setting with its meaning."""

from dataclasses import dataclass
from math import inf, radians

from fss_arm_calib.kinematic.problem import (
    CAUCHY,
    EQUAL,
    FULL,
    HEADING_DEVIATION,
    HUBER,
    OFFSETS,
    POSITION_DEVIATION,
    SQUARE,
)
from fss_arm_model.settings import setting


@dataclass(frozen=True)
class RestSettings:
    """What counts as a rest.

    Raises:
        ValueError: a setting is impossible.
    """

    still: float = setting(1e-3, "largest change of a joint's reading at rest [rad]")
    settle: float = setting(0.5, "time after the last motion that is not averaged [s]")
    shortest: float = setting(0.5, "least time to average over [s]")
    longest: float = setting(2.0, "time to average over if the arm rests that long [s]")
    joint_gap: float = setting(1.0, "silence of a joint that counts as a gap [s]")
    vicon_gap: float = setting(0.25, "silence of a VICON subject that counts as a gap [s]")
    max_speed: float = setting(
        5.0, "a subject's pose that would need a faster one is refused [m/s]"
    )
    max_turn: float = setting(10.0, "likewise [rad/s]")
    horizon: float = setting(60.0, "how far streams may lag each other [s]")
    kept: int = setting(200, "most rests used for a result, the newest; older ones go")

    def __post_init__(self) -> None:
        for name in (
            "still", "shortest", "longest", "joint_gap", "vicon_gap", "max_speed", "max_turn",
            "horizon",
        ):  # fmt: skip
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        if self.kept < 1:
            raise ValueError(f"kept is {self.kept}, must be at least 1")
        if not 0.0 <= self.settle < inf:
            raise ValueError(f"settle is {self.settle} s, must not be negative")
        if self.longest < self.shortest:
            raise ValueError(f"longest is {self.longest} s, must be at least {self.shortest} s")


@dataclass(frozen=True)
class Criteria:
    """What a calibration must meet to pass.

    Raises:
        ValueError: a criterion is impossible.
    """

    min_observations: int = setting(6, "fewest observations to judge by")
    max_condition: float = setting(200.0, "largest condition number of the column-scaled regressor")
    min_probability: float = setting(
        1e-3, "least chi-square probability of residuals as large as found"
    )
    outlier: float = setting(
        5.0, "normalized residual above which an observation is an outlier [deviations]"
    )
    max_outliers: int = setting(0, "most outliers to reject; with more, the calibration fails")
    min_redundancy: float = setting(
        0.1, "least share of an observation's error that the others let show, squared"
    )
    held_out: int = setting(
        4, "every so-manyth observation is predicted from the others, if enough remain; 0: none"
    )
    max_length_change: float = setting(
        0.05, "largest change of a link's length from the description; more is another arm [m]"
    )
    same_posture: float = setting(
        radians(1.0), "joints closer than this make a posture already observed [rad]"
    )

    def __post_init__(self) -> None:
        if self.min_observations < 1:
            raise ValueError(f"min_observations is {self.min_observations}, must be at least 1")
        if not self.max_condition > 1.0:
            raise ValueError(f"max_condition is {self.max_condition}, must be more than 1")
        if not 0.0 <= self.min_probability < 1.0:
            raise ValueError(f"min_probability is {self.min_probability}, must be in [0, 1)")
        if not self.outlier > 0.0:
            raise ValueError(f"outlier is {self.outlier}, must be positive")
        if self.max_outliers < 0:
            raise ValueError(f"max_outliers is {self.max_outliers}, must not be negative")
        if not 0.0 <= self.min_redundancy < 1.0:
            raise ValueError(f"min_redundancy is {self.min_redundancy}, must be in [0, 1)")
        if self.held_out < 0 or self.held_out == 1:
            raise ValueError(f"held_out is {self.held_out}, must be 0 or at least 2")
        if not self.max_length_change > 0.0:
            raise ValueError(f"max_length_change is {self.max_length_change} m, must be positive")
        if not self.same_posture > 0.0:
            raise ValueError(f"same_posture is {self.same_posture} rad, must be positive")


@dataclass(frozen=True)
class CalibrationSettings(RestSettings, Criteria):
    """Where the data come from, what is known beforehand, and how rests and results are judged.

    Raises:
        ValueError: a setting is impossible.
    """

    arm: str = setting("", "description YAML to begin from; empty: the paper's arm")
    parametrization: str = setting(
        EQUAL,
        f"{EQUAL}: one length for all links but the last; {FULL}: a length for each; {OFFSETS}: "
        "only the angles, as after a drive was switched off and on",
    )
    theta_e: bool = setting(False, "estimate the end effector subject's heading offset, too")
    loss: str = setting(
        SQUARE, f"{SQUARE}, or {HUBER} or {CAUCHY}, which let observations far off count less"
    )
    position_deviation: float = setting(
        POSITION_DEVIATION, "of an observed position, each axis, 1 sigma [m]"
    )
    heading_deviation: float = setting(HEADING_DEVIATION, "of an observed heading, 1 sigma [rad]")
    joints_topic: str = setting("joint_states", "readings of joint_1 .. joint_n")
    base_topic: str = setting("vicon/fss/fss", "poses of the base")
    tip_topic: str = setting("vicon/end_effector/end_effector", "poses of the end effector")

    def __post_init__(self) -> None:
        RestSettings.__post_init__(self)
        Criteria.__post_init__(self)
