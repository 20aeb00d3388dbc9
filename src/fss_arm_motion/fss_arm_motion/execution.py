"""Execution of a plan's file, without ROS: what it waits for, warns of and reports."""

from collections.abc import Sequence
from math import degrees, inf, isfinite, isnan
from typing import Protocol

from fss_arm_model.description import Arm
from fss_arm_motion.plan_file import Stored, digest

STALE_AFTER = 3.0  # age of a message beyond which its sender counts as silent [s]
REST_RATE = 0.01  # below it a joint rests [rad/s]
#: Changes of the base's pose in a report: name, unit, factor, decimals.
CHANGES = (("x", "mm", 1e3, 1), ("y", "mm", 1e3, 1), ("heading", "deg", degrees(1.0), 2))


class Report(Protocol):
    """Fields of a MotionReport that are printed."""

    arm: str
    predicted: Sequence[float]  # change of x, y [m], heading [rad]
    predicted_deviation: Sequence[float]  # 1 sigma; NaN: unknown
    measured: Sequence[float]  # NaN: unknown
    predicted_excursion: float  # [rad]
    measured_excursion: float  # [rad]


class ArmState:
    """Newest state of an arm of n joints, as far as a plan needs it.

    Times are of a monotonic clock [s].
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.armed: dict[int, tuple[float, bool]] = {}  # time of receipt and state, by link
        self.received = -inf  # time of the newest joint state
        self.rate = 0.0  # of the fastest joint [rad/s]
        self.description = ""  # name of the arm that runs

    def missing(self, now: float) -> str:
        """Return what a plan has to wait for; empty: the arm is ready."""
        if now - self.received > STALE_AFTER:
            return "arm/joint_states: the node arm and all links must run"
        received = {i for i, (at, _) in self.armed.items() if now - at <= STALE_AFTER}
        silent = [i for i in range(1, self.n + 1) if i not in received]
        if silent:
            return f"telemetry of {_links(silent)}"
        unarmed = [i for i in range(1, self.n + 1) if not self.armed[i][1]]
        if unarmed:
            return f"{_links(unarmed)} to be armed: scripts/fss_arm.sh arm"
        return "the arm to rest" if self.rate > REST_RATE else ""


def _links(numbers: list[int]) -> str:
    return f"link{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def other_description(stored: Stored, running: str, initial: Arm | None) -> str:
    """Return a warning if a plan is for another description than the node's; empty: it is not.

    Args:
        stored: the plan.
        running: name of the arm that runs, to which a calibration adds its date; empty: unknown.
        initial: initial description of the node `motion`; None: unknown.
    """
    if initial is None or digest(initial) == stored.digest:
        return ""
    if initial.name == stored.arm:
        return f"warning: {stored.arm!r} has changed since planning: the prediction is made again"
    if running == stored.arm:  # a calibration, which the node `motion` has received, too
        return ""
    return f"warning: the node motion has {initial.name!r}, this plan is for {stored.arm!r}"


def format_report(report: Report) -> str:
    """Return the predicted and the measured change of the base's pose as a table."""
    rows: list[tuple[str, ...]] = [
        ("change of the base", "predicted", "1 sigma", "measured", "difference")
    ]
    for k, (name, unit, factor, digits) in enumerate(CHANGES):
        predicted, sigma, measured = (
            factor * float(values[k])
            for values in (report.predicted, report.predicted_deviation, report.measured)
        )
        off = _number(measured - predicted, digits)
        if isfinite(measured) and sigma > 0.0:
            off += f" ({abs(measured - predicted) / sigma:.1f} sigma)"
        numbers = (_number(one, digits) for one in (predicted, sigma, measured))
        rows.append((f"  {name} [{unit}]", *numbers, off))
    largest = (degrees(one) for one in (report.predicted_excursion, report.measured_excursion))
    turned, seen = (_number(one, 2) for one in largest)
    rows.append(("  largest turn [deg]", turned, "", seen, ""))
    lines = ["{:<20}{:>11}{:>9}{:>10}{:>21}".format(*row).rstrip() for row in rows]
    if isnan(report.measured[0]):
        lines.append("not measured: no base/state was received")
    if isnan(report.predicted_deviation[0]):
        lines.append(f"1 sigma is unknown: {report.arm!r} has no calibration")
    return "\n".join(lines)


def _number(value: float, digits: int) -> str:
    return "-" if isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"
