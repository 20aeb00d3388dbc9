"""Dates of data and results. Simulated time starts in 1970, so it is no date."""

import re
from datetime import UTC, datetime

from fss_arm_model.units import SECOND

SIMULATED_UNTIL = 315_360_000 * SECOND  # ten years: no clock of real data is earlier [ns]
BAG_HASH = re.compile(r"(?:^|, )(.+?) [0-9a-f]{64}(?: \([^)]*\))?(?=, |$)", re.DOTALL)
CALIBRATED = ", calibrated "


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


def calibrated_name(arm: str, source: str, end: int) -> str:
    """Return the name of a calibrated arm, from that of the initial one, which may be calibrated.

    The data end at `end` [ns]; their source is `live`, or names and SHA-256 of bags.
    """
    bags = BAG_HASH.findall(source)
    origin = f"from {', '.join(bags)}" if bags else source
    name = f"{arm.partition(CALIBRATED)[0]}{CALIBRATED}{origin}, {format_time(end)}"
    return "".join(letter if letter.isprintable() else "?" for letter in name)
