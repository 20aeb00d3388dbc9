"""Settings of the guard: sizes and margins, as plain numbers without compiled code."""

from dataclasses import dataclass

from fss_arm_model.extents import Extents
from fss_arm_model.settings import NOT_NEGATIVE, above, setting


@dataclass(frozen=True)
class GuardSettings(Extents):
    """Sizes of the bodies, and the margins between them."""

    target_radius: float = setting(
        0.19, "radius of the target about the origin of its frame", unit="m", check=NOT_NEGATIVE
    )
    gripper_length: float = setting(
        0.15,
        "length of the end of the last link that may touch the target",
        unit="m",
        check=NOT_NEGATIVE,
    )
    gripper_depth: float = setting(
        0.03,
        "maximum depth of the gripper within the target's radius",
        unit="m",
        check=NOT_NEGATIVE,
    )
    margin: float = setting(0.05, "minimum gap between bodies", unit="m", check=NOT_NEGATIVE)
    edge_margin: float = setting(
        0.05, "minimum gap to the table's edge", unit="m", check=NOT_NEGATIVE
    )
    braking: float = setting(
        0.5,
        "deceleration of joints that the check of motions assumes, as a share of max_acceleration "
        "in the arm's description",
        check=above(0.0, 1.0),
    )
