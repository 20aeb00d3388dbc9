"""Constants that several packages need, and angles as messages show them."""

from collections.abc import Iterable
from math import degrees

GRAVITY = 9.81  # [m/s^2]
SECOND = 1_000_000_000  # [ns]


def number_text(value: float) -> str:
    """Return a number as messages show it: with six digits, or fewer if they are all."""
    return min(repr(float(value)), f"{value:.6g}", key=len) if value % 1 else repr(float(value))


def in_degrees(angles: Iterable[float]) -> str:
    """Return angles [rad] as a message shows them, such as `10, -45.5 deg`."""
    return f"{', '.join(f'{degrees(q):.4g}' for q in angles)} deg"


def angle_beyond(angle: float, low: float, high: float) -> str:
    """Return an angle outside its range, all [rad], as a refusal shows them.

    The excess is added where rounding hides it: 1.5708 rad is beyond 90 deg.
    """
    value, low, high = degrees(angle), degrees(low), degrees(high)
    rounded = float(f"{value:.4g}")
    excess = max(value - high, low - value)
    hidden = float(f"{low:.4g}") <= rounded <= float(f"{high:.4g}")
    beyond = f" ({excess:.2g} deg beyond)" if hidden else ""
    return f"{value:.4g} deg{beyond}, expected {low:.4g} to {high:.4g} deg"
