"""Dates of data and results, and errors of clocks, as texts.

Simulated time starts in 1970, so it is no date.
"""

from datetime import UTC, datetime

from fss_arm_model.units import SECOND

SIMULATED_UNTIL = 315_360_000 * SECOND  # ten years: no clock of real data is earlier [ns]
HOUR = 3600.0  # [s]
YEAR = 3.156e7  # [s]
MAX_CLOCK_ERROR = 1e8  # larger differences mean that a clock counts from its start [s]


def is_simulated(t: int) -> bool:
    """Return True if a time [ns] is of a simulator's clock."""
    return t < SIMULATED_UNTIL


def format_time(t: int) -> str:
    """Return a time [ns] of data as a date in UTC, or as seconds of simulated time."""
    if is_simulated(t):
        return f"{t / SECOND:.0f} s of simulated time"
    return f"{datetime.fromtimestamp(t / SECOND, UTC):%F %R} UTC"


def format_period(begin: int, end: int) -> str:
    """Return a period [ns] of data in this computer's time zone, or in simulated time."""
    if is_simulated(end):
        return f"{begin / SECOND:.0f} to {end / SECOND:.0f} s of simulated time"
    first, last = (datetime.fromtimestamp(t / SECOND, UTC).astimezone() for t in (begin, end))
    return f"{first:%F %H:%M} to {last:%H:%M %Z}"


def now() -> str:
    """Return the present date and time of this computer, in UTC."""
    return f"{datetime.now(UTC):%F %R}"


def describe_clock_error(error: float) -> str:
    """Describe in words how far a clock is ahead of or behind another one [s]."""
    direction, size = "ahead of" if error > 0.0 else "behind", abs(error)
    hours = round(size / HOUR)
    if size > MAX_CLOCK_ERROR:
        return f"{size / YEAR:.3g} years (does it count from its start?) {direction}"
    if hours and abs(size - hours * HOUR) < 0.02 * HOUR:
        return f"{size:.0f} s ({'an hour' if hours == 1 else f'{hours} hours'}) {direction}"
    return f"{size:.4g} s {direction}"
