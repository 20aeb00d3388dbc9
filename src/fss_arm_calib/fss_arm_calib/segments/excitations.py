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

from fss_arm_calib.segments.samples import Gap, Stream, find_silences
from fss_arm_calib.segments.sensors import count_rejected
from fss_arm_calib.segments.settings import ExcitationSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm
from fss_arm_model.units import SECOND

BLOCK = 4 * SECOND  # [ns]
BATCH_SIZE = 15  # excitations returned at once while the arm moves; each return triggers a solve
TOO_LATE = "late"


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


class FrameQueue(Stream):
    """Queue of a link's frames that are not evaluated yet."""

    def __init__(self, name: str, horizon: int) -> None:
        super().__init__(name, horizon)
        self.queue: deque[tuple[int, Frame]] = deque()

    def append(self, t: int, frame: Frame) -> None:
        """Append a frame of the link."""
        for sample in self.admit(t, frame):
            self.newest = sample[0]
            self.queue.append(sample)

    def pop_before(self, end: int) -> list[tuple[int, Frame]]:
        """Remove and return the frames before a time [ns]."""
        frames = []
        while self.queue and self.queue[0][0] < end:
            frames.append(self.queue.popleft())
        return frames


class ExcitationFinder:
    """Finder of excitations in the links' frames, after those `kept` by a previous run."""

    def __init__(
        self,
        arm: Arm,
        settings: ExcitationSettings | None = None,
        kept: Sequence[Excitation] = (),
    ) -> None:
        s = settings or ExcitationSettings()
        self.horizon, self.joint_gap = (round(t * SECOND) for t in (s.horizon, s.joint_gap))
        self.links = [FrameQueue(f"link_{i}", self.horizon) for i in range(1, arm.n + 1)]
        self._min_rates = [10.0 * s.min_speed * k.drive.counts_per_turn / tau for k in arm.links]
        self._evaluated_until = kept[-1].end + 1 if kept else 0  # [ns]
        self._last_turning = -2  # the last block in which a joint turned
        self._found: list[Excitation] = []
        for one in kept[-1:]:
            self._note_turning(one.end // BLOCK, [link.velocity for link in one.links])

    def add_frame(self, i: int, t: int, frame: Frame) -> list[Excitation]:
        """Process a frame of link i, 1 to n, at t [ns]; return the excitations it completes."""
        link = self.links[i - 1]
        link.append(t, frame)
        link.rejected[TOO_LATE] += len(link.pop_before(self._evaluated_until))
        return self._collect()

    def close(self) -> list[Excitation]:
        """Return the excitations if no frames follow, including the last block."""
        return self._collect(closing=True)

    def streams(self) -> Streams:
        """Return the state of the streams."""
        return Streams(
            silent=tuple(one.name for one in self.links if one.newest < 0),
            rejected=count_rejected(self.links),
            set_back={one.name: one.set_back / SECOND for one in self.links},
        )

    def _collect(self, closing: bool = False) -> list[Excitation]:
        at_rest = False
        while first := [one.queue[0][0] for one in self.links if one.queue]:
            block = min(first) // BLOCK
            complete = self._is_complete((block + 1) * BLOCK)
            if not (closing or complete):
                break
            self._evaluated_until = (block + 1) * BLOCK if complete else self._evaluated_until
            self._found += self._evaluate_block(block)
            at_rest = block > self._last_turning
        if not (closing or at_rest or len(self._found) >= BATCH_SIZE):
            return []
        found, self._found = self._found, []
        return found

    def _is_complete(self, end: int) -> bool:
        """Return True if all links have passed a time or have timed out."""
        newest = [one.newest for one in self.links]
        return min(newest) >= end or max(newest) - self.horizon > end

    def _note_turning(self, block: int, velocities: Sequence[Sequence[float]]) -> None:
        """Note the block if a joint turns in it, given the velocities of each link."""
        links = zip(velocities, self._min_rates, strict=False)  # a state file may have other links
        if any(abs(v) > min_rate for values, min_rate in links for v in values):
            self._last_turning = block

    def _evaluate_block(self, block: int) -> Iterator[Excitation]:
        """Yield the excitation in a block, if a joint turns."""
        rows = [one.pop_before((block + 1) * BLOCK) for one in self.links]
        self._note_turning(block, [[frame.velocity for _, frame in frames] for frames in rows])
        if block - self._last_turning > 1:
            return
        stamps = [t for frames in rows for t, _ in frames]
        start, end = min(stamps), max(stamps)
        reason = next(self._rejection_reasons(rows, start, end), "")
        yield Excitation(start, end, tuple(map(_combine_frames, rows)), not reason, reason)

    def _rejection_reasons(
        self, rows: Sequence[Sequence[tuple[int, Frame]]], start: int, end: int
    ) -> Iterator[str]:
        for link, frames in zip(self.links, rows, strict=True):
            homings = {frame.homings for _, frame in frames} - {0}
            if len({frame.boot for _, frame in frames}) > 1 or len(homings) > 1:
                yield f"{link.name} was homed or restarted"
            stamps = np.array([t for t, _ in frames], dtype=np.int64)
            for gap in find_silences(stamps, start, end, self.joint_gap):
                yield str(Gap(*gap, link.name))


def _combine_frames(rows: Sequence[tuple[int, Frame]]) -> Frames:
    frames = [frame for _, frame in rows]
    homings = [frame.homings for frame in frames if frame.homings]
    measured = (tuple(values) for values in zip(*(frame[:5] for frame in frames), strict=True))
    return Frames(
        frames[-1].boot if frames else 0,
        homings[-1] if homings else 0,
        tuple(t for t, _ in rows),
        *(measured if frames else [()] * 5),
    )
