"""Maneuvers out of streams: the arm rests, moves and rests again, and the base has reacted.

The arm rests while every joint's readings stay within `motion_threshold`; a pause
shorter than it takes to settle and to look twice is part of the motion. The second half of a rest,
up to `max_duration`, is the look before the next maneuver, the first half that after the last one:
no pose counts twice. In a look the base may drift, so its poses are averaged over short bins, each
a mark of the path.

A joint that moves while its link tells that it is not armed is moved by hand: then the base is
held, and what it does tells nothing of the arm.

How the base turns, by its gyro and by motion capture, tells the offset between their clocks; the
gyro's stamps are of the joints' clock. What was learned by then shifts the looks that follow.

As with rests.py, samples are merged by their stamps and nothing is decided before every stream has
passed the moment in question: what is found is a function of the data alone. Gyro, end effector and
telemetry may be absent; if they fall silent, they are waited for up to half of `horizon`.
"""

from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi
from typing import NamedTuple

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.alignment import NEWEST, WORST, Offset, mean_offset, offset_of_move
from fss_arm_calib.segments.poses import FROZEN, SECOND, Hole, Poses, mean_pose, seen_from
from fss_arm_calib.segments.rests import BASE, TIP
from fss_arm_calib.segments.samples import Gyro, Link, Samples, Told
from fss_arm_calib.segments.settings import ManeuverSettings
from fss_arm_calib.segments.streams import Merge, Stream, Streams
from fss_arm_model.base_motion import Path, path, sampled
from fss_arm_model.planar import wrap

SEARCH = 0.5  # for an offset, about the one allowed for [s]
PATIENCE = 0.5  # of the horizon, for what may be absent

_Looks = tuple[tuple[int, int], tuple[int, int]]  # begin and end, before and after [ns]

_CLEANING = 1000  # samples between two looks at what may be forgotten


@dataclass(frozen=True)
class Maneuver:
    """A motion of the arm between two rests, and what the base did."""

    start: int  # of the look before [ns]
    end: int  # of the look after
    times: tuple[tuple[float, ...], ...]  # (n) of each joint's samples, from `start` on [s]
    q: tuple[tuple[float, ...], ...]  # (n) readings then [rad]; at rest before and after
    qd: tuple[tuple[float, ...], ...]  # (n) rates then [rad/s]
    marks: tuple[float, ...] = ()  # (m) of the base's averaged poses, from `start` on [s]
    poses: tuple[tuple[float, ...], ...] = ()  # (m) x, y [m], heading [rad], counting turns
    frames: tuple[int, ...] = ()  # (m) averaged
    seconds: tuple[float, ...] = ()  # (m) over which [s]
    tip: tuple[float, ...] = ()  # end effector in the base's frame, before [m, m, rad]
    time_offset: float = 0.0  # of the joints' stamps against motion capture's, as allowed for [s]
    used: bool = True
    reason: str = ""  # why it is not used

    def path(self) -> Path:
        """The joints' path, with the base's poses as its marks."""
        law, edges = sampled(self.times, self.q, self.qd)
        return path(law, edges, self.marks)

    @property
    def moved(self) -> tuple[int, ...]:
        """Which joints moved, from 1."""
        return tuple(i for i, t in enumerate(self.times, 1) if len(t) > 1)


class _Rest(NamedTuple):
    """All joints still."""

    begin: int  # [ns]
    end: int  # as far as known
    moved: int  # a moment just before, at which some joint was moving; -1: none is known


class ManeuverFinder:
    """Fed samples of n joints, the base and its gyro, returns the maneuvers that they complete.

    Each feeding method returns the maneuvers found by it, in order of time. Stamps are integer
    nanoseconds. The gyro may be absent: it is needed only where the base was not seen for long. So
    may the end effector, which only tells whose arm it is, and the links' telemetry.
    """

    def __init__(self, n: int, settings: ManeuverSettings | None = None) -> None:
        self.settings = s = settings or ManeuverSettings()
        self.joints = [Samples(f"joint_{i}") for i in range(1, n + 1)]
        self.base = Poses(BASE, s.max_speed, s.max_turn)
        self.tip = Poses(TIP, s.max_speed, s.max_turn)
        self._lag(round(s.time_offset * SECOND))
        self.gyro = Gyro()
        self.links = [Link() for _ in self.joints]
        self.offset = Offset()  # between the clocks
        self._offsets: deque[Offset] = deque(maxlen=NEWEST)  # by each maneuver
        self._merge = Merge(self.joints, s.horizon)
        self._before: _Rest | None = None  # the rest that the next maneuver begins with
        self._pending: list[tuple[_Rest, _Rest]] = []
        self._until_cleaning = _CLEANING

    def joint(self, i: int, t: int, q: float, qd: float) -> list[Maneuver]:
        """A reading q [rad] and rate qd [rad/s] of joint i, 1 to n; NaN: no rate is known."""
        for joint in self._merge.add(i, t, q, qd):
            self._take(joint)
        return self._collect()

    def pose(self, t: int, pose: tuple[float, float, float] | None) -> list[Maneuver]:
        """A pose x [m], y [m], heading [rad] of the base; None: it was not visible."""
        self.base.append(t, pose)
        return self._collect()

    def poses(self, t: np.ndarray, poses: Floats) -> list[Maneuver]:
        """Many poses of the base at once, (k,) and (k, 3); NaN: it was not visible."""
        self.base.extend(t, poses)
        return self._collect()

    def tip_pose(self, t: int, pose: tuple[float, float, float] | None) -> list[Maneuver]:
        """A pose of the end effector, likewise."""
        self.tip.append(t, pose)
        return self._collect()

    def tip_poses(self, t: np.ndarray, poses: Floats) -> list[Maneuver]:
        """Many poses of the end effector at once, likewise."""
        self.tip.extend(t, poses)
        return self._collect()

    def rate(self, t: int, rate: float) -> list[Maneuver]:
        """A turn rate of the base [rad/s]."""
        self.gyro.append(t, rate)
        return self._collect()

    def rates(self, t: np.ndarray, rates: Floats) -> list[Maneuver]:
        """Many turn rates of the base at once, (k,) each."""
        for stamp, rate in zip(t.tolist(), rates.tolist(), strict=True):
            self.gyro.append(stamp, rate)
        return self._collect()

    def telemetry(self, i: int, t: int, armed: bool, boot: int, homings: int) -> list[Maneuver]:
        """What link i, 1 to n, tells: whether it is armed, its start, and its homings since."""
        if 1 <= i <= len(self.links):
            self.links[i - 1].append(Told(t, armed, (boot, homings)))
        return self._collect()

    def close(self) -> list[Maneuver]:
        """What can be said with no more samples to come: the maneuver before the last rest."""
        for joint in self._merge.rest():
            self._take(joint)
        self._end(self._rest())
        return self._collect(everything=True)

    def streams(self) -> Streams:
        """What befell the streams so far."""
        needed: list[Stream] = [*self.joints, self.base]
        return Streams.of(needed, self._merge.strange, self.tip, offset=self.offset)

    def _take(self, joint: Samples) -> None:
        """The next sample is a joint's."""
        rest = self._rest()
        if joint.take(self.settings.motion_threshold):
            self._end(rest)

    def _rest(self) -> _Rest | None:
        """The present rest, as far as all joints confirm it, if it is long enough to count."""
        if any(joint.start < 0 for joint in self.joints):
            return None
        begin, end = max(j.start for j in self.joints), min(j.last for j in self.joints)
        rest = _Rest(begin, end, max(j.moved for j in self.joints))
        return rest if self._look(rest) >= self.settings.min_duration * SECOND else None

    def _look(self, rest: _Rest) -> int:
        """How long a look at each end of a rest may last [ns]."""
        usable = rest.end - rest.begin - round(self.settings.settle_time * SECOND)
        return min(round(self.settings.max_duration * SECOND), usable // 2)

    def _looks(self, before: _Rest, after: _Rest) -> _Looks:
        """The looks before and after a maneuver."""
        settled = after.begin + round(self.settings.settle_time * SECOND)
        return (
            (before.end - self._look(before), before.end),
            (settled, settled + self._look(after)),
        )

    def _end(self, rest: _Rest | None) -> None:
        """The arm moves on: a rest that counts ends a maneuver and begins the next."""
        if rest is None:
            return
        # What was solved amid a rest has ended it before.
        if self._before and rest.begin > self._before.end:
            self._pending.append((self._before, rest))
        self._before = rest

    def _collect(self, everything: bool = False) -> list[Maneuver]:
        """Maneuvers that every stream has passed by now."""
        before, rest = self._before, self._rest()
        full = rest is not None and self._look(rest) == round(self.settings.max_duration * SECOND)
        if before and rest and full and rest.begin > before.end:
            # A long rest's look after the maneuver is settled before the rest is over.
            self._pending.append((before, rest))
            self._before = None
        found = []
        while self._pending and (everything or self._passed(*self._pending[0])):
            found.append(self._maneuver(*self._pending.pop(0)))
        self._until_cleaning -= 1
        if self._until_cleaning <= 0:
            self._forget()
        return [maneuver for maneuver in found if maneuver]

    @property
    def _horizon(self) -> int:
        return round(self.settings.horizon * SECOND)

    def _passed(self, before: _Rest, after: _Rest) -> bool:
        """Whether all has been heard of a maneuver, or is waited for no longer."""
        end = self._looks(before, after)[1][1]
        late = end + round(PATIENCE * self._horizon)
        links = [(link.newest, 0) for link in self.links]
        optional = [(self.gyro.newest, 0), (self.tip.newest, self.tip.lag), *links]
        heard = all(newest < 0 or newest + lag >= end for newest, lag in optional)
        given_up = max(joint.newest for joint in self.joints) - self._horizon > end
        return given_up or self.base.reached >= (end if heard else late)

    def _maneuver(self, before: _Rest, after: _Rest) -> Maneuver | None:
        """What happened between two rests; None if no joint moved far enough to be called so."""
        looks = self._looks(before, after)
        start, end = looks[0][0], looks[1][1]
        if (lasts := (end - start) / SECOND) > self.settings.horizon:  # its begin is forgotten
            nothing = ((),) * len(self.joints)
            reason = f"it lasts {lasts:.0f} s, at most {self.settings.horizon:g} s are followed"
            return Maneuver(start, end, nothing, nothing, nothing, used=False, reason=reason)
        series = []
        holes: list[Hole] = []
        for joint in self.joints:
            holes += self._holes(joint, start, end)
            # A joint that rests may be silent for `joint_gap`, which may be longer than a look.
            holes += [Hole(*look, joint.name) for look in looks if not len(joint.within(*look)[0])]
            series.append(self._samples(joint, looks))
        travel = max(float(np.ptp(q)) if len(q) else 0.0 for _, q, _ in series)
        if not holes and travel < self.settings.least_travel:
            return None
        times, q, qd = (
            tuple(tuple(part.tolist()) for part in parts) for parts in zip(*series, strict=True)
        )
        maneuver = Maneuver(start, end, times, q, qd)
        holes += self._frozen(looks, before, after)
        if reason := str(holes[0]) if holes else self._spoiled(maneuver):
            return replace(maneuver, used=False, reason=reason)
        tip = seen_from(self.base, self.tip, *looks[0])[1]
        if len(tip) > 1:
            maneuver = replace(maneuver, tip=tuple(mean_pose(tip).tolist()))
        maneuver = replace(self._seen(maneuver, looks), time_offset=self.base.lag / SECOND)
        self._align(start, end)
        return maneuver

    def _frozen(self, looks: _Looks, *rests: _Rest) -> list[Hole]:
        """Looks with poses that the base has had since before the arm came to rest."""
        found = []
        for look, rest in zip(looks, rests, strict=True):
            if number := self.base.frozen(*look, rest.moved):
                self.base.refused[FROZEN] += number
                found.append(Hole(*look, BASE, FROZEN))
        return found

    def _spoiled(self, maneuver: Maneuver) -> str:
        """What telemetry tells against a maneuver; empty: nothing."""
        span = maneuver.start, maneuver.end
        for i, (joint, link) in enumerate(zip(self.joints, self.links, strict=True), 1):
            if link.homed(*span):
                return f"{joint.name} homed or restarted"
            readings = (joint.within(*part)[1] for part in link.disarmed(*span))
            travel = max((float(np.ptp(q)) for q in readings if len(q)), default=0.0)
            if i in maneuver.moved and travel > self.settings.motion_threshold:
                return f"{joint.name} moved while disarmed"
        return ""

    def _align(self, begin: int, end: int) -> None:
        """Learn the clocks' offset from how the base turned."""
        gap = self.settings.vicon_gap * SECOND
        turned = self.gyro.angles(begin, end, gap)
        if turned is None or self.base.holes(begin, end, gap):
            return
        t, poses = self.base.slice(begin, end)
        within = np.array([SEARCH, (end - begin) / SECOND - SEARCH])
        gyro, seen = (turned[0] - begin) / SECOND, (t - begin) / SECOND
        psi = np.unwrap(poses[:, 2])
        found = offset_of_move(within, [(gyro, turned[1])], seen, psi, SEARCH)
        if found.deviation <= WORST:
            self._offsets.append(replace(found, value=found.value + self.base.lag / SECOND))
            self.offset = mean_offset(self._offsets)
            self._lag(round(self.offset.value * SECOND))

    def _lag(self, lag: int) -> None:
        """Joints' stamps are so much more [ns] than motion capture's."""
        self.base.lag = self.tip.lag = lag

    def _holes(self, joint: Samples, start: int, end: int) -> list[Hole]:
        """Silences of a joint that tell nothing of where it went meanwhile."""
        t, q, _ = joint.within(start, end)
        if not len(q):
            return [Hole(start, end, joint.name)]
        moved = np.concatenate(
            [[True], np.abs(np.diff(q)) > self.settings.motion_threshold, [True]]
        )
        t = np.concatenate([[start], t, [end]])
        late = np.flatnonzero((np.diff(t) > self.settings.joint_gap * SECOND) & moved)
        return [Hole(int(t[k]), int(t[k + 1]), joint.name) for k in late]

    def _samples(self, joint: Samples, looks: _Looks) -> tuple[Floats, Floats, Floats]:
        """Times from the start [s], readings and rates: at rest, the averages of both looks.

        Of a joint that did not move, one sample.
        """
        (start, departure), (arrival, _) = looks
        t, q, qd = joint.within(departure + 1, arrival - 1)
        ends = [joint.within(*look)[1] for look in looks]
        if not all(map(len, ends)):
            return np.empty(0), np.empty(0), np.empty(0)
        first, last = (float(np.mean(readings)) for readings in ends)
        if np.abs(np.array([*q, last]) - first).max() <= self.settings.motion_threshold:
            t, q, qd = (np.empty(0, kind) for kind in (np.int64, float, float))
            return np.array([(departure - start) / SECOND]), np.array([first]), np.zeros(1)
        times = (np.concatenate([[departure], t, [arrival]]) - start) / SECOND
        q, qd = np.concatenate([[first], q, [last]]), np.concatenate([[0.0], qd, [0.0]])
        return times, q, np.where(np.isfinite(qd), qd, np.gradient(q, times))

    def _seen(self, maneuver: Maneuver, looks: _Looks) -> Maneuver:
        """The maneuver with the base's poses, averaged over bins."""
        t, poses = self.base.slice(maneuver.start, maneuver.end)
        inside = (t >= maneuver.start) & (t <= maneuver.end)
        t, poses = t[inside], poses[inside]
        try:
            poses[:, 2] = self._unwrapped(t, poses[:, 2])
        except _LostTurn as lost:
            return replace(maneuver, used=False, reason=str(lost))
        marks, means, frames, seconds = [], [], [], []
        for begin, end in looks:
            count = max(1, round((end - begin) / SECOND / self.settings.bin))
            edges = np.linspace(begin, end, count + 1)
            seen = 0
            for low, high in pairwise(edges):
                those = (t >= low) & (t < high)
                number = int(np.count_nonzero(those))
                if number < 2:
                    continue
                seen += 1
                marks.append(float(np.mean(t[those] - maneuver.start)) / SECOND)
                means.append(tuple(np.mean(poses[those], axis=0).tolist()))
                frames.append(number)
                seconds.append(float(np.ptp(t[those])) / SECOND * number / (number - 1))
            if not seen:
                return replace(maneuver, used=False, reason=str(Hole(begin, end, BASE)))
        return replace(
            maneuver,
            marks=tuple(marks),
            poses=tuple(means),
            frames=tuple(frames),
            seconds=tuple(seconds),
        )

    def _unwrapped(self, t: np.ndarray, heading: Floats) -> Floats:
        """Headings that count turns, the gyro telling those between poses far apart.

        Raises:
            _LostTurn: the base may have turned by half a turn or more, unseen.
        """
        bridge = np.zeros(len(t))
        for k in np.flatnonzero(np.diff(t) > pi / self.settings.max_base_turn * SECOND):
            turned = self.gyro.turn(int(t[k]), int(t[k + 1]), self.settings.vicon_gap * SECOND)
            if turned is None:
                raise _LostTurn(Hole(int(t[k]), int(t[k + 1]), BASE))
            bridge[k + 1] = turned
        steps = np.diff(heading, prepend=heading[:1])
        return heading[:1] + np.cumsum(bridge + wrap(steps - bridge))

    def _forget(self) -> None:
        """Drop what no maneuver will ask for."""
        self._until_cleaning = _CLEANING
        look = round((2.0 * self.settings.max_duration + 1.0) * SECOND)
        rests = [pair[0] for pair in self._pending] + ([self._before] if self._before else [])
        kept = rests[0].end if rests else min(joint.last for joint in self.joints)
        # The longest maneuver, and as much again for streams that lag.
        span = 2 * self._horizon
        needed: list[Samples | Poses] = [*self.joints, self.base]
        oldest = max(kept - look, max(stream.newest for stream in needed) - span)
        for stream in needed:
            stream.forget(oldest)
        # What may be absent has a say in its own samples only: its clock may be wrong.
        self.tip.forget(max(oldest, self.tip.newest - span))
        self.gyro.forget(max(oldest, self.gyro.newest - span))
        for link in self.links:
            link.forget(max(oldest, link.newest - span))


class _LostTurn(Exception):  # noqa: N818
    """Nobody knows how far the base turned meanwhile."""

    def __init__(self, hole: Hole) -> None:
        super().__init__(f"{hole}, and no gyro")
