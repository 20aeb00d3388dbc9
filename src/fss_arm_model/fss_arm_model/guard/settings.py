"""Settings of the guard: sizes and margins, as plain numbers without compiled code."""

from dataclasses import dataclass

from fss_arm_model.extents import Extents
from fss_arm_model.settings import NOT_NEGATIVE, above, setting


@dataclass(frozen=True)
class GuardSettings(Extents):
    """Sizes of the bodies, and the margins between them."""

    target_radius: float = setting(
        0.19, "radius within which the gripper's target lies about its origin", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    gripper_length: float = setting(
        0.15, "length of the last link's end that may touch the target", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    gripper_depth: float = setting(
        0.03, "how far the gripper may reach into the target's radius", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    margin: float = setting(
        0.05, "least gap that the guard leaves between bodies", unit="m", check=NOT_NEGATIVE
    )
    edge_margin: float = setting(
        0.05, "least gap that the guard leaves to the table's edge", unit="m", check=NOT_NEGATIVE
    )
    braking: float = setting(
        0.5, "share of the drives' accelerations that the arm is sure to brake with, for all their "
        "torque is limited", check=above(0.0, 1.0),
    )  # fmt: skip
