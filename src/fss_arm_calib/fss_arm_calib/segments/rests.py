"""Observations out of streams: where the arm rested, and the average of each rest.

An arm rests while every joint's readings stay within `motion_threshold` of each other; once it
has settled, the first interval of `max_duration` without a gap in any stream becomes one
Observation, or, if the arm moves on earlier, the longest such interval of at least `min_duration`.
There is one observation for each rest, whoever moved the arm.

Streams arrive each in its own order and rate, and interleaved at will: samples are merged by their
stamps, and nothing is decided before every stream has passed the moment in question. What is found
is therefore a function of the data alone, the same live, replayed and read from a file, as long as
no stream lags another by more than `horizon`.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, nan
from operator import itemgetter
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.alignment import LONGEST_MOVE, Alignment
from fss_arm_calib.segments.poses import (
    FROZEN,
    HEADING_NOISE,
    JUMP,
    POSITION_NOISE,
    SECOND,
    Hole,
    Poses,
    Stamps,
    mean_pose,
    seen_from,
)
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.streams import Joint, Merge, Streams
from fss_arm_model.planar import wrap

BASE, TIP = "fss", "end_effector"  # the two subjects, as the motion capture system names them

MOST_CONTRADICTING = 0.1  # share of a rest's poses that may be refused as jumps

_CLEANING = 1000  # samples between two looks at what may be forgotten


@dataclass(frozen=True)
class Observation:
    """One rest of the arm: the end effector seen from the base, and the joints' readings."""

    start: int  # of the averaged interval [ns]
    end: int
    q: tuple[float, ...]  # (n) averaged readings [rad]
    tip: tuple[float, ...] = (nan, nan, nan)  # end effector in the base's frame [m, m, rad]
    scatter: tuple[float, ...] = (nan, nan, nan)  # of single frames about tip, 1 sigma
    joint_samples: int = 0  # fewest readings of one joint averaged
    vicon_frames: int = 0  # pairs of poses averaged
    time_offset: float = 0.0  # of the joints' stamps against motion capture's, as allowed for [s]
    boots: tuple[int, ...] = ()  # (n) start of each link's electronics; 0: not told
    homings: tuple[int, ...] = ()  # (n) how often its drive was referenced since; 0: not told
    used: bool = True
    reason: str = ""  # why it is not used


def spoiled(observations: Sequence[Observation], tolerance: float) -> list[Observation]:
    """The unused ones whose posture has not been observed otherwise within `tolerance` [rad]."""
    seen = [np.array(o.q) for o in observations if o.used]
    return [
        o
        for o in observations
        if not o.used and not any(np.all(np.abs(q - o.q) <= tolerance) for q in seen)
    ]


class Referenced(Protocol):
    """What holds as long as the joints keep their zeros."""

    @property
    def boots(self) -> tuple[int, ...]:
        """(n) start of each link's electronics; 0: not told."""

    @property
    def homings(self) -> tuple[int, ...]:
        """(n) how often its drive was referenced since; 0: not told."""


def homed(before: Referenced, after: Referenced) -> list[int]:
    """Numbers of the joints whose zeros may have changed in between.

    The drive was referenced anew, or the link's electronics restarted, perhaps the drive with it.
    """
    keys = zip(before.boots, before.homings, after.boots, after.homings, strict=False)
    return [i for i, (a, m, b, n) in enumerate(keys, 1) if m and n and (a, m) != (b, n)]


def since_homed(observations: Sequence[Observation]) -> list[Observation]:
    """Those with the same zeros of the joints as the last one: only they have offsets in common."""
    return [o for o in observations if not homed(o, observations[-1])]


class _Rest(NamedTuple):
    """All joints still, the settling time left out; samples of each joint; gaps in them."""

    begin: int
    end: int
    q: tuple[float, ...]  # amid all readings of each joint, whatever was forgotten of them
    readings: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]]
    holes: list[Hole]
    moved: int  # a moment just before, at which some joint was moving; -1: none is known
    boots: tuple[int, ...]  # as an Observation's
    homings: tuple[int, ...]


class _Joint(Joint):
    """One joint's current run of still readings."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.t: list[int] = []
        self.q: list[float] = []
        self.holes: list[Hole] = []
        self.start = self.last = self.moved = -1
        self.low, self.high = inf, -inf
        self.references: list[tuple[int, int, int]] = []  # each from when on, start and homings

    def reference(self, t: float) -> tuple[int, int]:
        """Start of the electronics and homings as told until t, or first, if later; 0: never."""
        k = bisect_right(self.references, t, key=itemgetter(0))
        return self.references[max(k - 1, 0)][1:] if self.references else (0, 0)

    def begin(self, t: int, q: float) -> None:
        self.t, self.q, self.holes = [t], [q], []
        self.moved = self.last
        self.start = self.last = t
        self.low = self.high = q

    def extend(self, t: int, q: float, gap: float) -> None:
        if t - self.last > gap:
            self.holes.append(Hole(self.last, t, self.name))
        self.t.append(t)
        self.q.append(q)
        self.last = t
        self.low, self.high = min(self.low, q), max(self.high, q)

    def still_with(self, q: float, tolerance: float) -> bool:
        return max(self.high, q) - min(self.low, q) <= tolerance

    def forget(self, before: float) -> None:
        k = bisect_left(self.t, before)
        del self.t[:k], self.q[:k]


class RestFinder:
    """Fed samples of n joints and two subjects, returns the observations that they complete.

    Each feeding method returns the observations found by it, in order of time. Stamps are integer
    nanoseconds; a sample that is not newer than its stream's last one is dropped.

    Args:
        n: number of joints.
        settings: what counts as a rest.
        resting_at: (n) posture of the last observation made before the finder was started; if the
            arm has not moved since, it is not observed again.
    """

    def __init__(
        self,
        n: int,
        settings: RestSettings | None = None,
        resting_at: Sequence[float] | None = None,
    ) -> None:
        self.settings = settings or RestSettings()
        self.joints = [_Joint(f"joint_{i}") for i in range(1, n + 1)]
        s = self.settings
        self.subjects = {name: Poses(name, s.max_speed, s.max_turn) for name in (BASE, TIP)}
        self.alignment = Alignment(n, s.motion_threshold, s.settle_time + s.min_duration)
        self._merge = Merge(self.joints, s.horizon)
        self._pending: list[_Rest] = []
        self._settled = 0  # when the present rest began to count
        self._confirmed = -1  # up to when all joints are known to rest
        self._observed = False  # the present rest is done with
        self._whole_since = 0  # the present rest had a gap until then, as far as was looked
        self._aligned = 0  # begin of the last rest that the clocks were aligned for
        self._resting_at = resting_at
        self._until_cleaning = _CLEANING

    def joint(self, i: int, t: int, q: float) -> list[Observation]:
        """A reading q [rad] of joint i; beyond n it is another arm's, and counted as such."""
        for joint in self._merge.add(i, t, q):
            self._take(joint)
        self._until_cleaning -= 1
        return self._collect()

    def reference(self, i: int, t: int, boot: int, homings: int) -> None:
        """What link i tells of its start and of how often its drive was referenced; 0: nothing."""
        if not 1 <= i <= len(self.joints) or not homings:
            return
        told = self.joints[i - 1].references
        if not told or (t > told[-1][0] and told[-1][1:] != (boot, homings)):
            told.append((t, boot, homings))

    def pose(
        self, subject: str, t: int, pose: tuple[float, float, float] | None
    ) -> list[Observation]:
        """A pose x [m], y [m], heading [rad] of a subject; None: it was not visible."""
        self.subjects[subject].append(t, pose)
        self._until_cleaning -= 1
        return self._collect()

    def poses(
        self, subject: str, t: npt.NDArray[np.int64], poses: npt.NDArray[np.float64]
    ) -> list[Observation]:
        """Many poses of a subject at once, (k,) and (k, 3); NaN: it was not visible."""
        self.subjects[subject].extend(t, poses)
        self._until_cleaning -= len(t)
        return self._collect()

    def close(self) -> list[Observation]:
        """What can be said with no more samples to come: the last rest, if long enough."""
        for joint in self._merge.rest():
            self._take(joint)
        newest = max(joint.newest for joint in self.joints)
        rests, self._pending = self._pending, []
        found = [self._observe_ended(rest) for rest in rests]
        if not self._done() and (rest := self._rest(newest)):
            found.append(self._observe_ended(rest))
            self._observed = found[-1] is not None
        return [observation for observation in found if observation]

    def streams(self) -> Streams:
        """What befell the streams so far."""
        boots, homings = self._references(inf)
        return Streams.of(
            self._streams,
            self._merge.strange,
            offset=self.alignment.offset,
            offset_beyond=self.alignment.beyond,
            boots=boots,
            homings=homings,
        )

    def _references(self, t: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Starts and homings of all links as told until t."""
        boots, homings = zip(*(joint.reference(t) for joint in self.joints), strict=True)
        return boots, homings

    @property
    def _streams(self) -> list[_Joint | Poses]:
        return [*self.joints, *self.subjects.values()]

    def _take(self, joint: _Joint) -> None:
        """The next sample is a joint's."""
        t, q, _ = joint.waiting.popleft()
        self.alignment.reading(self.joints.index(joint) + 1, t, q)
        if joint.last >= 0 and joint.still_with(q, self.settings.motion_threshold):
            joint.extend(t, q, self.settings.joint_gap * SECOND)
        else:
            if joint.last >= 0:  # it moved
                if not self._done() and (rest := self._rest(t)):
                    self._pending.append(rest)
                self._observed, self._resting_at = False, None
                self._whole_since = 0
            joint.begin(t, q)
            start = max(j.start for j in self.joints)
            self._settled = start + round(self.settings.settle_time * SECOND)
        self._confirmed = min(j.last for j in self.joints)

    def _done(self) -> bool:
        """Whether the present rest needs no observation any more."""
        return self._observed or (
            self._resting_at is not None
            and all(
                joint.still_with(q, 2.0 * self.settings.motion_threshold)
                for joint, q in zip(self.joints, self._resting_at, strict=True)
            )
        )

    def _rest(self, until: int | None = None) -> _Rest | None:
        """The present rest as far as all joints confirm it.

        With `until`, the moment at which it ended, a joint silent for long then is a gap up to it.
        """
        begin, end = self._settled, self._confirmed
        if end <= begin:
            return None
        holes = [hole for j in self.joints for hole in j.holes]
        if until is not None:
            gap = self.settings.joint_gap * SECOND
            late = [Hole(j.last, until, j.name) for j in self.joints if until - j.last > gap]
            holes += late
            end = until if late else end
        q = tuple(0.5 * (j.low + j.high) for j in self.joints)
        readings = [(np.array(j.t), np.array(j.q)) for j in self.joints]
        moved = max(j.moved for j in self.joints)
        return _Rest(begin, end, q, readings, holes, moved, *self._references(end))

    def _collect(self) -> list[Observation]:
        """Observations that every stream has passed by now, or is waited for no longer."""
        found = []
        while self._pending and self._decided(self._pending[0]):
            self._align(self._pending[0].begin, min(self._pending[0].end, self._seen))
            if not self._decided(self._pending[0]):
                break  # by the new offset
            over = self._pending.pop(0)
            missing = [
                Hole(poses.reached, over.end, poses.name)
                for poses in self.subjects.values()
                if poses.reached < over.end
            ]
            found.append(self._observe(over._replace(holes=over.holes + missing), over=True))
        if not self._pending:
            self._align(self._settled, min(self._seen, self._confirmed))
            if self._long_enough(self._seen) and (rest := self._rest()):
                until = min(rest.end, self._seen)
                found.append(self._observe(rest._replace(end=until), over=False))
                self._observed = found[-1] is not None
        if self._until_cleaning <= 0:
            self._forget()
        return [observation for observation in found if observation]

    def _decided(self, rest: _Rest) -> bool:
        """Whether what can be seen of a rest that is over has been heard."""
        return rest.end <= self._seen or rest.end < self._newest - self._horizon

    @property
    def _horizon(self) -> int:
        return round(self.settings.horizon * SECOND)

    @property
    def _newest(self) -> int:
        return max(stream.newest for stream in self._streams)

    @property
    def _seen(self) -> int:
        """Up to when both subjects have been heard."""
        return min(poses.reached for poses in self.subjects.values())

    def _observe_ended(self, rest: _Rest) -> Observation | None:
        """The observation of a rest, with no more samples to come."""
        self._align(rest.begin, min(rest.end, self._seen))
        return self._observe(rest, over=True)

    def _align(self, begin: int, until: int) -> None:
        """Learn the clocks' offset from the move before a rest that all have heard of by now."""
        heard = begin + round(self.settings.min_duration * SECOND)
        if self._aligned == begin or until < heard:
            return
        self._aligned = begin
        move = self.alignment.move(begin - round(self.settings.settle_time * SECOND))
        if not move:
            return
        search = round(self.alignment.search * SECOND)
        first, last = move[0] - search, max(move[1] + search, heard)
        gap = self.settings.vicon_gap * SECOND
        if any(poses.holes(first, last, gap) for poses in self.subjects.values()):
            return
        t, seen = self._from_base(first, last)
        lag = self.subjects[BASE].lag
        self.alignment.learn(*move, heard, t - lag, np.unwrap(seen[:, 2]))
        if self.alignment.offset.deviation < inf:
            for poses in self.subjects.values():
                poses.lag = round(self.alignment.offset.value * SECOND)

    def _long_enough(self, seen: int) -> bool:
        """Whether the present rest may hold an interval of full length, told without arrays."""
        least = self.settings.max_duration * SECOND
        since = max(self._settled, self._whole_since)
        return min(seen, self._confirmed) - since >= least and not self._done()

    def _observe(self, rest: _Rest, over: bool) -> Observation | None:
        """The observation of a rest; None if it is too short, or may yet become longer."""
        shortest, longest = (
            round(s * SECOND) for s in (self.settings.min_duration, self.settings.max_duration)
        )
        # A stream that has not begun is no gap; what is older than the horizon may be forgotten.
        begun = max(poses.begun for poses in self.subjects.values())
        begin = max(rest.begin, begun, rest.end - self._horizon - longest)
        if rest.end - begin < shortest or any(p.first < 0 for p in self.subjects.values()):
            return None
        holes = [hole for hole in rest.holes if hole.end > begin and hole.start < rest.end]
        for poses in self.subjects.values():
            gap = self.settings.vicon_gap * SECOND
            holes += poses.holes(begin, rest.end, gap, rest.moved)
        pieces = _pieces(begin, rest.end, holes)
        whole = [(a, a + longest) for a, b in pieces if b - a >= longest]
        if not whole and over:
            best = max(pieces, key=lambda piece: piece[1] - piece[0], default=(0, 0))
            whole = [best] if best[1] - best[0] >= shortest else []
        if not whole and not over:
            self._whole_since = max(hole.end for hole in holes) if holes else begin
            return None
        for poses in self.subjects.values():
            poses.refused[FROZEN] += poses.frozen(begin, rest.end, rest.moved)
        if whole:
            return self._average(rest, *whole[0])
        # What is beyond the rest is not told: it may have been forgotten, or not heard yet.
        told = [
            hole._replace(start=max(hole.start, begin), end=min(hole.end, rest.end))
            for hole in holes
        ]
        return _unused(rest, str(max(told, key=lambda hole: hole.end - hole.start)))

    def _average(self, rest: _Rest, begin: int, end: int) -> Observation:
        inside = [q[(t >= begin) & (t <= end)] for t, q in rest.readings]
        for joint, q in zip(self.joints, inside, strict=True):
            if not len(q):
                return _unused(rest, f"no reading of {joint.name}")
        seen = self._from_base(begin, end, rest.moved)[1]
        if len(seen) < 2:
            return _unused(rest, "fewer than 2 pairs of poses")
        together = _together(seen)
        self.subjects[TIP].refused[JUMP] += int(np.sum(~together))
        if np.mean(together) < 1.0 - MOST_CONTRADICTING:
            return _unused(rest, "poses contradict each other")
        seen = seen[together]
        mean = mean_pose(seen)
        away = seen - mean
        away[:, 2] = wrap(away[:, 2])
        return Observation(
            start=begin,
            end=end,
            q=tuple(float(q.mean()) for q in inside),
            tip=tuple(mean.tolist()),
            scatter=tuple(np.sqrt(np.sum(away**2, axis=0) / (len(away) - 1)).tolist()),
            joint_samples=min(map(len, inside)),
            vicon_frames=len(seen),
            time_offset=self.subjects[BASE].lag / SECOND,
            boots=rest.boots,
            homings=rest.homings,
        )

    def _from_base(self, begin: int, end: int, moved: int = -1) -> tuple[Stamps, Floats]:
        """Stamps and poses of the end effector seen from the base within an interval."""
        return seen_from(self.subjects[BASE], self.subjects[TIP], begin, end, moved)

    def _forget(self) -> None:
        """Drop what no observation will ask for.

        The past, and what lies beyond the horizon, twice as far back for streams that lag.
        """
        self._until_cleaning = _CLEANING
        past = self._confirmed
        if self._pending:
            past = min(past, self._pending[0].begin)
        if not self._observed:
            past = min(past, max(j.start for j in self.joints))
        oldest = self._newest - 2 * self._horizon - round(self.settings.max_duration * SECOND)
        for joint in self.joints:
            joint.forget(max(past, oldest))
        # A rest's clocks are aligned by the move before it.
        past -= round((LONGEST_MOVE + 2.0 * self.alignment.search) * SECOND)
        for poses in self.subjects.values():
            poses.forget(max(past, oldest))
        self.alignment.forget(max(past, oldest))


def _pieces(begin: int, end: int, holes: list[Hole]) -> list[tuple[int, int]]:
    """What holes leave of an interval."""
    edges = [begin]
    for hole in sorted(holes):
        edges += [max(edges[-1], hole.start), max(edges[-1], hole.end)]
    edges.append(max(edges[-1], end))
    return [(a, b) for a, b in list(pairwise(edges))[::2] if b > a]


def _unused(rest: _Rest, reason: str) -> Observation:
    return Observation(
        rest.begin,
        rest.end,
        rest.q,
        boots=rest.boots,
        homings=rest.homings,
        used=False,
        reason=reason,
    )


def _together(seen: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Which poses (k, 3) are near most others: at rest the end effector stays where it is."""
    x, y = (seen[:, :2] - np.median(seen[:, :2], axis=0)).T
    mean = np.angle(np.median(np.cos(seen[:, 2])) + 1j * np.median(np.sin(seen[:, 2])))
    away = np.abs(wrap(seen[:, 2] - mean))
    return np.asarray((np.hypot(x, y) <= POSITION_NOISE) & (away <= HEADING_NOISE))
