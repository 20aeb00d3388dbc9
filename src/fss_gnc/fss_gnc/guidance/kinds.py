"""Actions of the guidance: the activities that their goals start, their results and feedback.

A new action is a record in KINDS; the node makes its server from it.
"""

from typing import Any

from fss_arm_msgs.action import AbortMission, Capture, Detumble, FollowPoses, GoToPose, HoldBase
from fss_gnc.guidance import abort, capture, detumble
from fss_gnc.guidance.activity import Commands, Outcome
from fss_gnc.guidance.base_motion import PathMotion, follow, go_to, hold
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.execution import Kind

MAX_REASON = 200  # characters


def _motion_result(motion: PathMotion, budget: Budget, outcome: Outcome) -> dict[str, Any]:
    return {"reached": outcome.success, "propellant": budget.propellant}


def _motion_feedback(motion: PathMotion, _: Commands) -> dict[str, Any]:
    return {"offset": motion.offset, "remaining": motion.remaining}


BASE = (
    Kind(
        "base/hold",
        HoldBase,
        lambda craft, obs, goal: hold(craft, obs, goal.pose, goal.duration),
        lambda motion, budget, outcome: {
            "held": outcome.success,
            "largest_offset": motion.largest_offset,
            "propellant": budget.propellant,
        },
        lambda motion, _: {"offset": motion.offset},
        preempts=("base/",),
    ),
    Kind(
        "base/go_to",
        GoToPose,
        lambda craft, obs, goal: go_to(craft, obs, goal.pose, goal.duration, goal.hold_duration),
        lambda motion, budget, outcome: (
            _motion_result(motion, budget, outcome) | {"offset": motion.offset}
        ),
        _motion_feedback,
        preempts=("base/",),
    ),
    Kind(
        "base/follow",
        FollowPoses,
        lambda craft, obs, goal: follow(craft, obs, goal.time, goal.pose, goal.twist),
        lambda motion, budget, outcome: (
            _motion_result(motion, budget, outcome) | {"largest_offset": motion.largest_offset}
        ),
        _motion_feedback,
        preempts=("base/",),
    ),
)


def _capture_result(mission: capture.Capture, budget: Budget, outcome: Outcome) -> dict[str, Any]:
    return {
        "captured": mission.captured,
        "stopped": outcome.success and mission.detumbles,
        "phase": "done" if outcome.success else mission.phase,
        "duration": budget.elapsed,
        "propellant": budget.propellant,
        "momentum": mission.momentum,
        "largest_torque": budget.largest_torque,
    }


def short_reason(reason: str, default: str = "requested by the operator") -> str:
    """Return the reason for the end of an activity as one short line."""
    return " ".join(reason.split())[:MAX_REASON] or default


MISSIONS = (
    Kind(
        "mission/capture",
        Capture,
        lambda craft, obs, goal: capture.Capture(craft, goal.detumble),
        _capture_result,
        lambda _, commands: {
            "phase": commands.phase,
            "fixture_distance": commands.fixture_distance,
        },
        preempts=("base/",),
    ),
    Kind(
        "mission/detumble",
        Detumble,
        lambda craft, obs, goal: detumble.Detumble(craft),
        lambda _, budget, outcome: {
            "stopped": outcome.success,
            "duration": budget.elapsed,
            "propellant": budget.propellant,
        },
        lambda mission, _: {"twist": mission.twist},
        preempts=("base/",),
    ),
    Kind(
        "mission/abort",
        AbortMission,
        lambda craft, obs, goal: abort.Abort(craft, short_reason(goal.reason), requested=True),
        lambda mission, *_: {"safe": mission.safe},
        lambda mission, _: {"target_clearance": mission.target_clearance},
        preempts=("base/", "mission/"),
    ),
)

KINDS: tuple[Kind, ...] = BASE + MISSIONS
