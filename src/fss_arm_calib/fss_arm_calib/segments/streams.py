"""Joints' readings, merged by their stamps on their way to a finder; what befell all streams."""

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any, Generic, Protocol, TypeVar

from fss_arm_calib.segments.alignment import Offset
from fss_arm_calib.segments.poses import OUT_OF_ORDER, REPEATED, SECOND


class Stream(Protocol):
    """Samples of one joint or subject."""

    name: str
    newest: int  # stamp [ns]; -1: none was heard
    refused: Counter[str]  # samples, by reason
    set_back: int  # longest step back of the stamps [ns]


@dataclass(frozen=True)
class Streams:
    """What befell the streams that a result is from."""

    silent: tuple[str, ...] = ()  # not heard yet
    strange: tuple[str, ...] = ()  # joints heard that the arm does not have
    refused: Mapping[str, int] = field(default_factory=dict)  # samples, by stream and reason
    set_back: Mapping[str, float] = field(default_factory=dict)  # longest step back of stamps [s]
    offset: Offset = field(default_factory=Offset)  # between the clocks
    offset_beyond: float = 0.0  # what it is more than, by most moves [s]
    boots: tuple[int, ...] = ()  # as an Observation's, at last
    homings: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, needed: Sequence[Stream], strange: set[int], *others: Stream, **more: Any
    ) -> "Streams":
        """Those needed, and others that may be silent; numbers of strange joints."""
        every = [*needed, *others]
        return cls(
            silent=tuple(stream.name for stream in needed if stream.newest < 0),
            strange=tuple(f"joint_{i}" for i in sorted(strange)),
            refused={
                f"{stream.name} {why}": number
                for stream in every
                for why, number in sorted(stream.refused.items())
                if number
            },
            set_back={stream.name: stream.set_back / SECOND for stream in every},
            **more,
        )


class Found(Protocol):
    """What a finder finds: to be solved from, or kept for its reason why not."""

    @property
    def used(self) -> bool:
        """Whether it is solved from."""


F = TypeVar("F", bound=Found)


def newest(found: Sequence[F], kept: int) -> list[F]:
    """The newest `kept` of those used, and since then at most as many of those that are not.

    What is spoiled thus never takes the place of what is well. To be called as things are found:
    it leaves what it would leave of all at once.
    """
    used = [k for k, one in enumerate(found) if one.used]
    first = used[-kept] if len(used) >= kept else 0
    unused = [k for k, one in enumerate(found) if k >= first and not one.used]
    which = {*used[-kept:], *unused[-kept:]}
    return [one for k, one in enumerate(found) if k in which]


class Joint:
    """The stream of one joint; what is kept of the samples that were merged is a finder's own."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.newest = -1
        self.refused: Counter[str] = Counter()
        self.set_back = 0
        self.waiting: deque[tuple[int, float, float]] = deque()  # stamp [ns], q, qd


J = TypeVar("J", bound=Joint)


class Merge(Generic[J]):
    """Hands on the samples of joints 1 to n in order of time, once every joint has passed them.

    A joint that lags the others by more than `horizon` [s] is waited for no longer: theirs would
    pile up while a link is silent.
    """

    def __init__(self, joints: Sequence[J], horizon: float) -> None:
        self.joints, self.horizon = joints, round(horizon * SECOND)
        self.strange: set[int] = set()  # numbers heard that the arm does not have

    def add(self, i: int, t: int, q: float, qd: float = nan) -> Iterator[J]:
        """Take a reading [rad] and rate [rad/s] of joint i at t [ns].

        Yields each joint whose oldest waiting sample is next, for it to be taken off.
        """
        if not 1 <= i <= len(self.joints):
            self.strange.add(i)
            return
        joint = self.joints[i - 1]
        if not isfinite(q):
            joint.refused["not finite"] += 1
        elif t <= joint.newest:
            joint.refused[REPEATED if t == joint.newest else OUT_OF_ORDER] += 1
            joint.set_back = max(joint.set_back, joint.newest - t)
        else:
            joint.newest = t
            joint.waiting.append((t, q, qd))
            while (oldest := self._oldest()) and self._passed(oldest.waiting[0][0]):
                yield oldest

    def rest(self) -> Iterator[J]:
        """The same with no more to come."""
        while oldest := self._oldest():
            yield oldest

    def _oldest(self) -> J | None:
        waiting = (joint for joint in self.joints if joint.waiting)
        return min(waiting, key=lambda joint: joint.waiting[0][0], default=None)

    def _passed(self, t: int) -> bool:
        if all(joint.waiting for joint in self.joints):
            return True
        return max(joint.newest for joint in self.joints) - t > self.horizon
