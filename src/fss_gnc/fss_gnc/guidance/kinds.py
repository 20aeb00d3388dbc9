"""The actions of the guidance: what their goals begin, and what they say of it.

A new one is a record in KINDS; the node makes its server from it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fss_arm_msgs.action import FollowPoses, GoToPose, HoldBase
from fss_gnc.guidance.account import Account
from fss_gnc.guidance.activity import Activity, Craft, Ended, Orders, Seen
from fss_gnc.guidance.base_motion import AlongPath, follow, go_to, hold


@dataclass(frozen=True)
class Kind:
    """An action of the guidance."""

    name: str
    action: Any  # its type; its results have a `message`
    begin: Callable[[Craft, Seen, Any], Activity]  # from a goal, or ActivityError
    result: Callable[[Any, Account, Ended], dict[str, Any]]  # of an activity: the other fields
    feedback: Callable[[Any, Orders], dict[str, Any]]
    preempts: tuple[str, ...] = ()  # names begin so of the actions that it takes the place of


def _reached(motion: AlongPath, account: Account, ended: Ended) -> dict[str, Any]:
    return {"reached": ended.well, "propellant": account.propellant}


def _progress(motion: AlongPath, _: Orders) -> dict[str, Any]:
    return {"offset": motion.offset, "remaining": motion.remaining}


BASE = (
    Kind(
        "base/hold", HoldBase,
        lambda craft, seen, goal: hold(craft, seen, goal.pose, goal.duration),
        lambda motion, account, ended: {
            "held": ended.well, "largest_offset": motion.largest_offset,
            "propellant": account.propellant,
        },
        lambda motion, _: {"offset": motion.offset},
        preempts=("base/",),
    ),
    Kind(
        "base/go_to", GoToPose,
        lambda craft, seen, goal: go_to(craft, seen, goal.pose, goal.duration, goal.hold_duration),
        lambda motion, account, ended: _reached(motion, account, ended) | {"offset": motion.offset},
        _progress, preempts=("base/",),
    ),
    Kind(
        "base/follow", FollowPoses,
        lambda craft, seen, goal: follow(craft, seen, goal.time, goal.pose, goal.twist),
        lambda motion, account, ended: _reached(motion, account, ended)
        | {"largest_offset": motion.largest_offset},
        _progress, preempts=("base/",),
    ),
)  # fmt: skip

#: mission/* comes here: capture and detumble with preempts=("base/",), abort with both.
KINDS: tuple[Kind, ...] = BASE
