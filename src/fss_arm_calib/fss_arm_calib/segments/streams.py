"""State of the streams that a result is computed from, and selection of the data to keep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Protocol, TypeVar

from fss_arm_calib.segments.alignment import Offset


@dataclass(frozen=True)
class Streams:
    """State of the streams that a result is computed from."""

    silent: tuple[str, ...] = ()  # streams without any sample yet
    unknown: tuple[str, ...] = ()  # joints received that the arm does not have
    other_names: tuple[str, ...] = ()  # names of joints received that are not joint_<i>
    rejected: Mapping[str, int] = field(default_factory=dict)  # samples, by stream and reason
    set_back: Mapping[str, float] = field(default_factory=dict)  # longest step back of stamps [s]
    offset: Offset = field(default_factory=Offset)  # between the clocks
    offset_lower_bound: float = 0.0  # if the offset was outside the search, else 0 [s]
    frames: Mapping[str, str] = field(default_factory=dict)  # frame id of each subject seen
    problems: tuple[str, ...] = ()  # problems that may hide all data
    gyro_ratio: float = nan  # base's rotation by the gyro over that by motion capture
    boots: tuple[int, ...] = ()  # latest values, as in Observation
    homings: tuple[int, ...] = ()


class Datum(Protocol):
    """Datum of a calibration: used in the solution, or kept for the reason why not."""

    @property
    def start(self) -> int:
        """Start of the datum [ns]."""

    @property
    def end(self) -> int:
        """End of the datum [ns]."""

    @property
    def used(self) -> bool:
        """True if the datum may be used in a solution."""

    @property
    def reason(self) -> str:
        """Reason why the datum is not used."""


D = TypeVar("D", bound=Datum)


def keep_newest(found: Sequence[D], max_count: int) -> list[D]:
    """Return the newest used data, and at most as many unused data since the first of these.

    Rejected data therefore never displace used data. The function can be called whenever data are
    found: repeated calls keep the same data as one call for all of them.
    """
    used = [k for k, one in enumerate(found) if one.used]
    first = used[-max_count] if len(used) >= max_count else 0
    unused = [k for k, one in enumerate(found) if k >= first and not one.used]
    which = {*used[-max_count:], *unused[-max_count:]}
    return [one for k, one in enumerate(found) if k in which]
