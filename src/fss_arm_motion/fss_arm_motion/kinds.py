"""The kinds of plans, by name: their settings, and the functions that plan them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fss_arm_motion.best_posture import BestPosture, best_posture
from fss_arm_motion.plan import Plan, Start
from fss_arm_motion.point_to_point import PointToPoint, point_to_point
from fss_arm_motion.reorientation import Reorientation, reorientation
from fss_arm_motion.tip_path import TipPath, tip_path
from fss_arm_motion.zero_reaction import ZeroReaction, zero_reaction


@dataclass(frozen=True)
class Kind:
    """A kind of plan."""

    name: str
    about: str
    settings: type[Any]
    plan: Callable[[Start, Any], Plan]


KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "point_to_point",
            "To a posture, as fast as possible, or with the least base rotation in a given time.",
            PointToPoint,
            point_to_point,
        ),
        Kind(
            "zero_reaction",
            "Along a direction as far as it goes, or to a posture, without turning the base.",
            ZeroReaction,
            zero_reaction,
        ),
        Kind(
            "reorientation",
            "Turn the base by an angle; the arm returns to its posture.",
            Reorientation,
            reorientation,
        ),
        Kind(
            "tip_path",
            "The end effector along a line or through points, in the world's or the base's frame.",
            TipPath,
            tip_path,
        ),
        Kind(
            "best_posture",
            "To the posture in which the end effector moves best along a direction.",
            BestPosture,
            best_posture,
        ),
    )
}
