"""What became of the streams that a result is from, and which results to keep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Protocol, TypeVar

from fss_arm_calib.segments.alignment import Offset


@dataclass(frozen=True)
class Streams:
    """What became of the streams that a result is from."""

    silent: tuple[str, ...] = ()  # not heard yet
    unknown: tuple[str, ...] = ()  # joints heard that the arm does not have
    others: tuple[str, ...] = ()  # names of joints heard that are not joint_<i>
    rejected: Mapping[str, int] = field(default_factory=dict)  # samples, by stream and reason
    set_back: Mapping[str, float] = field(default_factory=dict)  # longest step back of stamps [s]
    offset: Offset = field(default_factory=Offset)  # between the clocks
    offset_beyond: float = 0.0  # what it is more than, by most moves [s]
    frames: Mapping[str, str] = field(default_factory=dict)  # frame id of each subject seen
    doubts: tuple[str, ...] = ()  # what about them may hide all data
    gyro_ratio: float = nan  # of the base's turns by the gyro to those by motion capture
    boots: tuple[int, ...] = ()  # as an Observation's, at last
    homings: tuple[int, ...] = ()


class Found(Protocol):
    """What a finder finds: to be solved from, or kept for its reason why not."""

    @property
    def used(self) -> bool:
        """Whether it is solved from."""


F = TypeVar("F", bound=Found)


def newest(found: Sequence[F], most: int) -> list[F]:
    """The newest `most` of those used, and since then at most as many of those that are not.

    What is rejected thus never takes the place of what is well. To be called as things are found:
    it leaves what it would leave of all at once.
    """
    used = [k for k, one in enumerate(found) if one.used]
    first = used[-most] if len(used) >= most else 0
    unused = [k for k, one in enumerate(found) if k >= first and not one.used]
    which = {*used[-most:], *unused[-most:]}
    return [one for k, one in enumerate(found) if k in which]
