"""Settings of a joint estimate; its data have the settings of their calibration kinds."""

from dataclasses import dataclass
from math import radians
from typing import ClassVar

from fss_arm_calib.dynamic.knowledge import Knowledge
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.segments.settings import sigma
from fss_arm_model.choice import Choice
from fss_arm_model.settings import like, setting


@dataclass(frozen=True)
class JointSettings(Knowledge):
    """Settings of a joint estimate: prior knowledge and criteria."""

    ABOUT: ClassVar = (
        "All parameters of the arm at once, from the rests, maneuvers and drifts of the nodes "
        "kinematic, dynamic and drift, or of bags."
    )

    arm: str = setting("", "arm to start from: file or built in (paper, cad, truth); empty: paper")
    priors: str = setting(
        "m_i I_i m_0 I_0 com_0",
        "parameters whose described value is a prior, such as 'b_i I_0'",
    )
    theta_e: bool = setting(False, "estimate the heading offset of the end effector's subject, too")
    zero_deviation: float = sigma(
        radians(5.0), "rad", "the change of a joint's zero from bag to bag, or by a homing; 0: none"
    )
    min_probability: float = like(DynamicSettings, "min_probability")
    max_relative: float = like(DynamicSettings, "max_relative")
    max_place: float = like(DynamicSettings, "max_place")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.priors.strip():
            Choice.of(self.priors, 12, "priors")
