"""Actions of the guidance: the activities that their goals start, their results and feedback.

A new action is a record in KINDS; the node makes its server from it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fss_arm_msgs.action import AbortMission, Capture, Detumble, FollowPoses, GoToPose, HoldBase
from fss_gnc.guidance import abort, capture, detumble
from fss_gnc.guidance.activity import Activity, Craft, Ended, Orders, Seen
from fss_gnc.guidance.base_motion import AlongPath, follow, go_to, hold
from fss_gnc.guidance.budget import Budget

MAX_REASON = 200  # characters


@dataclass(frozen=True)
class Kind:
    """Definition of one action of the guidance."""

    name: str
    action: Any  # its type; its results have a `message`
    begin: Callable[[Craft, Seen, Any], Activity]  # from a goal; may raise ActivityError
    result: Callable[[Any, Budget, Ended], dict[str, Any]]  # fields except `message`
    feedback: Callable[[Any, Orders], dict[str, Any]]
    preempts: tuple[str, ...] = ()  # prefixes of the names of the actions that it preempts


def _reached(motion: AlongPath, budget: Budget, ended: Ended) -> dict[str, Any]:
    return {"reached": ended.well, "propellant": budget.propellant}


def _progress(motion: AlongPath, _: Orders) -> dict[str, Any]:
    return {"offset": motion.offset, "remaining": motion.remaining}


BASE = (
    Kind(
        "base/hold", HoldBase,
        lambda craft, seen, goal: hold(craft, seen, goal.pose, goal.duration),
        lambda motion, budget, ended: {
            "held": ended.well, "largest_offset": motion.largest_offset,
            "propellant": budget.propellant,
        },
        lambda motion, _: {"offset": motion.offset},
        preempts=("base/",),
    ),
    Kind(
        "base/go_to", GoToPose,
        lambda craft, seen, goal: go_to(craft, seen, goal.pose, goal.duration, goal.hold_duration),
        lambda motion, budget, ended: _reached(motion, budget, ended) | {"offset": motion.offset},
        _progress, preempts=("base/",),
    ),
    Kind(
        "base/follow", FollowPoses,
        lambda craft, seen, goal: follow(craft, seen, goal.time, goal.pose, goal.twist),
        lambda motion, budget, ended: _reached(motion, budget, ended)
        | {"largest_offset": motion.largest_offset},
        _progress, preempts=("base/",),
    ),
)  # fmt: skip


def _captured(mission: capture.Capture, budget: Budget, ended: Ended) -> dict[str, Any]:
    return {
        "captured": mission.captured, "stopped": ended.well and mission.detumbles,
        "phase": "done" if ended.well else mission.phase, "duration": budget.elapsed,
        "propellant": budget.propellant, "momentum": mission.momentum,
        "largest_torque": budget.largest_torque,
    }  # fmt: skip


def _reason(given: str) -> str:
    """Return the reason for an abort as one short line."""
    return " ".join(given.split())[:MAX_REASON] or "asked for"


MISSIONS = (
    Kind(
        "mission/capture", Capture,
        lambda craft, seen, goal: capture.Capture(craft, goal.detumble),
        _captured,
        lambda _, orders: {"phase": orders.phase, "fixture_distance": orders.fixture_distance},
        preempts=("base/",),
    ),
    Kind(
        "mission/detumble", Detumble, lambda craft, seen, goal: detumble.Detumble(craft),
        lambda _, budget, ended: {
            "stopped": ended.well, "duration": budget.elapsed, "propellant": budget.propellant,
        },
        lambda mission, _: {"twist": mission.twist},
        preempts=("base/",),
    ),
    Kind(
        "mission/abort", AbortMission,
        lambda craft, seen, goal: abort.Abort(craft, _reason(goal.reason), asked=True),
        lambda mission, *_: {"safe": mission.safe},
        lambda mission, _: {"target_clearance": mission.target_clearance},
        preempts=("base/", "mission/"),
    ),
)  # fmt: skip

KINDS: tuple[Kind, ...] = BASE + MISSIONS
