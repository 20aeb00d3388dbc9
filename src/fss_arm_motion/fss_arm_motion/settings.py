"""The parameters of the node `motion`."""

from dataclasses import dataclass
from math import radians

from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, between, setting


@dataclass(frozen=True)
class MotionSettings(Settings):
    """The parameters of a MotionNode."""

    arm: str = setting(
        "",
        "arm until a calibration passes: file or built in (paper, cad, truth); empty: paper",
    )
    lead: float = setting(
        1.0,
        "time from a plan to the start of its motion, in which the links receive it",
        unit="s",
        check=between(0.0, 60.0),
    )
    motion_threshold: float = setting(
        0.01,
        "joint rate above which the arm moves, and no plan is made",
        unit="rad/s",
        check=POSITIVE,
    )
    max_age: float = setting(
        1.0,
        "maximum age of the state of arm and base that a plan starts from",
        unit="s",
        check=POSITIVE,
    )
    tolerance: float = setting(
        0.02,
        "maximum distance of a joint from the start of a path from a file",
        unit="rad",
        check=POSITIVE,
    )
    tracking: float = setting(
        radians(0.04),
        "tracking error of the joints that predictions assume, 1 sigma",
        unit="rad",
        check=NOT_NEGATIVE,
    )
