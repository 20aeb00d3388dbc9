"""Excitations found in the links' telemetry: frames of all links while a joint turns.

Time is divided into blocks at multiples of BLOCK. A block is an excitation if a joint turns in it
or turned in the block before: links keep swinging, and a torque sensor at rest shows its zero. A
block is evaluated when all links have passed it or have timed out. The result therefore depends on
the data alone, as with other finders.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import tau
from typing import NamedTuple

import numpy as np

from fss_arm_calib.segments.samples import SECOND, Gap, Stream, silences
from fss_arm_calib.segments.settings import ExcitationSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm

BLOCK = 4 * SECOND  # [ns]
TOGETHER = 15  # excitations returned together while the arm moves: each return triggers a solve
LATE = "late"


class Frame(NamedTuple):
    """Telemetry frame of a link, with the raw values of LinkTelemetry."""

    position: float  # [counts]
    velocity: float  # [0.1 counts/s]
    current: float  # [0.01 A]
    torque: float  # [counts]
    torque_age: float  # [ms]
    boot: int  # identifies the start of the link's electronics
    homings: int  # number of homings of the drive since then; 0: not known


@dataclass(frozen=True)
class Frames:
    """Successive frames of a link, (k) values each, in order of time."""

    boot: int  # of the last frame
    homings: int  # of the last frame in which they are known
    stamps: tuple[int, ...]  # times of measurement [ns]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    torque: tuple[float, ...]
    torque_age: tuple[float, ...]


@dataclass(frozen=True)
class Excitation:
    """Frames of all links while a joint turned."""

    start: int  # time of the first frame [ns]
    end: int
    links: tuple[Frames, ...]  # (n)
    used: bool = True
    reason: str = ""  # why it is not used

    @property
    def boots(self) -> tuple[int, ...]:
        """Start of each link's electronics (n); 0: not known."""
        return tuple(one.boot for one in self.links)

    @property
    def homings(self) -> tuple[int, ...]:
        """Number of homings of each drive since then (n); 0: not known."""
        return tuple(one.homings for one in self.links)


class Reports(Stream):
    """Frames of a link that are not evaluated yet."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.waiting: deque[tuple[int, Frame]] = deque()

    def append(self, t: int, frame: Frame) -> None:
        """Append a frame of the link."""
        for sample in self.admit(t, frame):
            self.newest = sample[0]
            self.waiting.append(sample)

    def before(self, end: int) -> list[tuple[int, Frame]]:
        """Remove and return the frames before a time [ns]."""
        found = []
        while self.waiting and self.waiting[0][0] < end:
            found.append(self.waiting.popleft())
        return found


class ExcitationFinder:
    """Finder of excitations in the telemetry frames of an arm's links.

    Args:
        arm: arm whose encoder resolutions convert velocities.
        settings: definition of an excitation.
        kept: excitations of a previous run.
    """

    def __init__(
        self,
        arm: Arm,
        settings: ExcitationSettings | None = None,
        kept: Sequence[Excitation] = (),
    ) -> None:
        s = settings or ExcitationSettings()
        self.horizon, self.joint_gap = (round(t * SECOND) for t in (s.horizon, s.joint_gap))
        self.links = [Reports(f"link_{i}", self.horizon) for i in range(1, arm.n + 1)]
        self._slow = [10.0 * s.min_speed * k.drive.counts_per_turn / tau for k in arm.links]
        self._since = kept[-1].end + 1 if kept else 0  # earlier frames are evaluated [ns]
        self._turned = -2  # the last block in which a joint turned
        self._found: list[Excitation] = []
        for one in kept[-1:]:
            self._note(one.end // BLOCK, [link.velocity for link in one.links])

    def frame(self, i: int, t: int, frame: Frame) -> list[Excitation]:
        """Process a frame of link i, 1 to n, at t [ns]; return the excitations it completes."""
        link = self.links[i - 1]
        link.append(t, frame)
        link.rejected[LATE] += len(link.before(self._since))
        return self._collect()

    def close(self) -> list[Excitation]:
        """Return the excitations if no frames follow, including the last block."""
        return self._collect(closing=True)

    def streams(self) -> Streams:
        """Return the state of the streams."""
        return Streams(
            silent=tuple(one.name for one in self.links if one.newest < 0),
            rejected={
                f"{one.name} {why}": number
                for one in self.links
                for why, number in sorted(one.rejected.items())
                if number
            },
            set_back={one.name: one.set_back / SECOND for one in self.links},
        )

    def _collect(self, closing: bool = False) -> list[Excitation]:
        rests = False
        while first := [one.waiting[0][0] for one in self.links if one.waiting]:
            block = min(first) // BLOCK
            decided = self._decided((block + 1) * BLOCK)
            if not (closing or decided):
                break
            self._since = (block + 1) * BLOCK if decided else self._since
            self._found += self._excitations(block)
            rests = block > self._turned
        if not (closing or rests or len(self._found) >= TOGETHER):
            return []
        found, self._found = self._found, []
        return found

    def _decided(self, end: int) -> bool:
        """Return True if all links have passed a time or have timed out."""
        newest = [one.newest for one in self.links]
        return min(newest) >= end or max(newest) - self.horizon > end

    def _note(self, block: int, velocities: Sequence[Sequence[float]]) -> None:
        """Note the block if a joint turns in it, given the velocities of each link."""
        links = zip(velocities, self._slow, strict=False)  # a state file may have other links
        if any(abs(velocity) > slow for those, slow in links for velocity in those):
            self._turned = block

    def _excitations(self, block: int) -> Iterator[Excitation]:
        """Yield the excitation in a block, if a joint turns."""
        rows = [one.before((block + 1) * BLOCK) for one in self.links]
        self._note(block, [[frame.velocity for _, frame in those] for those in rows])
        if block - self._turned > 1:
            return
        stamps = [t for those in rows for t, _ in those]
        start, end = min(stamps), max(stamps)
        reason = next(self._reasons(rows, start, end), "")
        yield Excitation(start, end, tuple(map(_frames, rows)), not reason, reason)

    def _reasons(
        self, rows: Sequence[Sequence[tuple[int, Frame]]], start: int, end: int
    ) -> Iterator[str]:
        """Yield reasons to reject an excitation."""
        for link, those in zip(self.links, rows, strict=True):
            homings = {frame.homings for _, frame in those} - {0}
            if len({frame.boot for _, frame in those}) > 1 or len(homings) > 1:
                yield f"{link.name} was homed or restarted"
            stamps = np.array([t for t, _ in those], dtype=np.int64)
            for gap in silences(stamps, start, end, self.joint_gap):
                yield str(Gap(*gap, link.name))


def _frames(rows: Sequence[tuple[int, Frame]]) -> Frames:
    """Combine successive frames of a link."""
    every = [frame for _, frame in rows]
    told = [frame.homings for frame in every if frame.homings]
    return Frames(
        boot=every[-1].boot if every else 0,
        homings=told[-1] if told else 0,
        stamps=tuple(t for t, _ in rows),
        position=tuple(frame.position for frame in every),
        velocity=tuple(frame.velocity for frame in every),
        current=tuple(frame.current for frame in every),
        torque=tuple(frame.torque for frame in every),
        torque_age=tuple(frame.torque_age for frame in every),
    )
