"""Acceptance of a calibration: checks, and the verdict that follows from them.

Each check compares a value with a threshold. A calibration passes if all its checks pass; it fails
if one fails; it is not evaluated if data for a needed check are missing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

PASS, FAIL, NOT_EVALUATED = "pass", "fail", "not_evaluated"

FIT = "fit"  # name of the check of all residuals; its chi-square is the one reported
CAUSE = "cause"  # name of the check that gives the probable cause of a bad verdict
MAX_LENGTH = 74  # characters of a reason that fit in the line of a verdict, after "fail: "
MAX_NAMED = 2  # uncertain parameters named in the line of a verdict
MAX_REASONS = 4  # limit if the verdict is not pass; the checks hold all reasons


@dataclass(frozen=True)
class Check:
    """Criterion that a calibration must meet to pass, with the fields of Check.msg."""

    name: str
    verdict: str
    value: float
    threshold: float
    reason: str  # text with value and threshold
    needed: bool = True  # must be evaluated for a verdict; a failed check always counts
    brief: str = ""  # key number of a pass, or the reason in few words if it needs several lines


def decide_verdict(checks: Sequence[Check]) -> tuple[str, tuple[str, ...]]:
    """Return the verdict of all checks and its reasons: causes, missing data, failures, notes.

    If a needed check could not be evaluated, the verdict is "not evaluated" even if others failed,
    because the missing data may be the cause. The reasons of a pass are those of the checks passed.
    """
    verdict, deciding = _decide(checks)
    reasons = tuple(check.reason for check in deciding)
    return verdict, reasons if verdict == PASS else tuple(dict.fromkeys(reasons))[:MAX_REASONS]


def _decide(checks: Sequence[Check]) -> tuple[str, list[Check]]:
    """Return the verdict and the checks that give its reasons, the most important one first."""
    causes = [c for c in checks if c.name == CAUSE]
    others = [c for c in checks if c.name != CAUSE]
    missing = [c for c in others if c.verdict == NOT_EVALUATED and c.needed]
    failed = [c for c in others if c.verdict == FAIL]
    notes = [c for c in others if c.verdict == NOT_EVALUATED and not c.needed]
    verdict = NOT_EVALUATED if missing else FAIL if failed else PASS
    deciding = others if verdict == PASS else [*causes, *missing, *failed, *notes]
    return verdict, [c for c in deciding if c.reason]


def summarize(checks: Sequence[Check], uncertain: Mapping[str, float] | None = None) -> str:
    """Return the reason of a verdict in one line: the first one, or the key numbers of a pass.

    In a pass, `uncertain`, the relative deviations of parameters too uncertain to use, takes the
    place of the second number.
    """
    verdict, deciding = _decide(checks)
    numbers = [c.brief for c in deciding if c.brief] if verdict == PASS else []
    if verdict == PASS and uncertain:
        return "; ".join([*numbers[:1], f"do not rely on {format_uncertain(uncertain)}"])
    reasons = ((c.brief if len(c.reason) > MAX_LENGTH else "") or c.reason for c in deciding)
    return ", ".join(numbers) or next(reasons, "")


def format_uncertain(uncertain: Mapping[str, float]) -> str:
    """Format parameters with their relative deviations; after MAX_NAMED only their number."""
    words = [
        f"{name} (± {100 * share:.0f} %)" if share < inf else f"{name} (not determined)"
        for name, share in uncertain.items()
    ]
    more = f" and {len(words) - MAX_NAMED} more" if len(words) > MAX_NAMED else ""
    return f"{', '.join(words[:MAX_NAMED])}{more}"


def format_count(number: int, what: str) -> str:
    """Format a number with its noun, in the plural unless the number is 1."""
    return f"{number} {what}{'s' * (number != 1)}"


def format_indices(which: Sequence[int], noun: str = "observation") -> str:
    """Format indices of data as text, counted from 1."""
    return f"{noun}{'s' * (len(which) > 1)} {', '.join(str(k + 1) for k in which)}"
