"""Problems of the navigation, and statistics of its filters, for diagnostics."""

from collections.abc import Collection, Mapping
from typing import Any

from fss_arm_model.units import SECOND

from .body_filter import POSE, RATE
from .navigation import Navigation
from .tracked_body import TrackedBody
from .valve_faults import Faults

GYRO_TIMEOUT = SECOND // 2  # [ns]
FROM_FUTURE = "are in the future: clocks differ, or the test bed is too slow"


def find_problems(
    navigation: Navigation,
    base: TrackedBody,
    target: TrackedBody,
    now: int,
    topics_ahead: Collection[str] = (),
) -> list[str]:
    """Return all problems at a time [ns], in one sentence each.

    Args:
        navigation: the filters.
        base: publication of the base.
        target: publication of the target.
        now: the present in the time of the base's stamps [ns].
        topics_ahead: topics whose last stamp was from the future.
    """
    n, problems = navigation, []
    if base.lost_reason:
        problems.append(f"base {base.lost_reason}")
    elif (age := now - n.base.last_pose_time) > GYRO_TIMEOUT:
        problems.append(f"base predicted, not observed for {age / SECOND:.1f} s")
    if target.lost_reason and n.target.events:
        problems.append(f"target {target.lost_reason}")
    if n.base.events and now - n.base.last_rate_time > GYRO_TIMEOUT:
        problems.append("no gyro: heading from motion capture only")
    if not n.inputs.joints_are_recent(now):
        problems.append("readings of a joint are missing: motion of the arm unknown")
    if n.mass_estimator and not n.mass_estimator.is_consistent:
        problems.append("an unknown force pushes: no mass of the held body explains the motion")
    problems += [f"stamps of {topic} {FROM_FUTURE}" for topic in topics_ahead]
    problems += valve_problems(n.valves.faults)
    problems += [f"pose of the {name} fits the {other}" for name, other in n.recent_mixups(now)]
    return problems


def valve_problems(faults: Faults) -> list[str]:
    """Return the faults of the valves as sentences."""
    problems = [f"valve {i + 1} does not close" for i in sorted(faults.open)]
    problems += [f"valve {i + 1} does not open" for i in sorted(faults.closed)]
    return problems + ["an unknown force pushes the base"] * faults.unknown_push


def diagnostic_values(
    navigation: Navigation,
    base: TrackedBody,
    target: TrackedBody,
    pulses: int,
    rejected: Mapping[str, int],
) -> dict[str, Any]:
    """Return states and statistics, by their names in diagnostics.

    Args:
        navigation: the filters.
        base: publication of the base.
        target: publication of the target.
        pulses: number of accepted commands to the valves.
        rejected: number of messages that did not reach a filter, by topic and reason.
    """
    n = navigation
    values = {
        "base": base.lost_reason or "known",
        "target": target.lost_reason or ("held" if n.holds else "known"),
        "NIS of poses (expected: 3)": _mean(n.base.nis[POSE]),
        "NIS of rates (expected: 1)": _mean(n.base.nis[RATE]),
        "pulses received": pulses,
        "filter restarts": max(n.base.start_count - 1, 0),
        **rejected,
        **{f"base: {kind} rejected": count for kind, count in n.base.rejected.items()},
        **{f"target: {kind} rejected": count for kind, count in n.target.rejected.items()},
    }
    return values | ({"gyro bias [rad/s]": n.base.bias} if n.base.events else {})


def _mean(values: Collection[float]) -> float:
    return sum(values) / len(values) if values else float("nan")
