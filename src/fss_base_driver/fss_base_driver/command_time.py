"""Time of a command by its stamp; commands without one, or with a wrong one, are refused."""

from fss_arm_model.units import SECOND
from fss_link.host_clock import HostClock
from fss_link.session import CommandError

MAX_STAMP_LEAD = 0.5  # largest lead of a stamp over the clock [s]


def command_time(stamp: int, clock: HostClock, lifetime: float) -> int:
    """Return when a command was given, in the clock's steady time [ns].

    Args:
        stamp: of the command, in the time of day [ns]; 0: none.
        clock: of the computer.
        lifetime: largest age of the command [s].

    Raises:
        CommandError: it has no stamp, is too old, or has a stamp too far ahead.
    """
    now, offset = clock.now(), clock.offset
    if not stamp:
        raise CommandError("it has no stamp, so it could be an old recording")
    age = (now + offset - stamp) / SECOND
    if not -MAX_STAMP_LEAD <= age <= lifetime:
        raise CommandError(f"it is {age:.3f} s old, expected at most {lifetime:g} s")
    return min(now, stamp - offset)
