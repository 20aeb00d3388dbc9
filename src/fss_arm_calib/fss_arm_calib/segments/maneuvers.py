"""Maneuvers out of streams: the arm rests, moves and rests again, and the base has reacted.

A pause too short to settle and for two windows is part of the motion. The second half of a rest,
up to `max_duration`, is the window before the next maneuver, the first half that after the last
one: no pose counts twice. In a window the base may drift, so its poses are averaged over short
bins, each a knot of the path.

A joint that moves while its link reports that it is not armed is moved by hand: then the base is
held, and what it does says nothing of the arm.

How the base turns, by its gyro and by motion capture, gives the offset between their clocks; the
gyro's stamps are of the joints' clock. What was learned by then shifts the windows that follow.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, nan, pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.alignment import offset_of_move
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Joint, Rest
from fss_arm_calib.segments.poses import BASE, FROZEN, bins, mean_pose, seen_from
from fss_arm_calib.segments.samples import SECOND, Gap, Stamps
from fss_arm_calib.segments.settings import ManeuverSettings
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.joint_path import Path, path, sampled

LOOK = SECOND // 10  # over which a pose on the base's way is averaged [ns]
LEAST_SEEN = 1.0  # squares of the base's turns, of all frames, that the gyro is compared by [rad^2]


@dataclass(frozen=True)
class Maneuver:
    """A motion of the arm between two rests, and what the base did."""

    start: int  # of the window before [ns]
    end: int  # of the window after
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

    @cached_property
    def path(self) -> Path:
        """The joints' path, with the base's poses as its marks."""
        return self.path_at(self.marks)

    def path_at(self, marks: npt.ArrayLike) -> Path:
        """The joints' path with marks of one's own, (k,) from `start` on [s]."""
        law, edges = sampled(self.times, self.q, self.qd)
        return path(law, edges, marks)

    @property
    def underway(self) -> npt.NDArray[np.bool_]:
        """(m,) which marks are amid the motion."""
        ways = [t for t in self.times if len(t) > 1]
        begin, end = (min(t[0] for t in ways), max(t[-1] for t in ways)) if ways else (inf, -inf)
        return (np.array(self.marks) > begin) & (np.array(self.marks) < end)

    @property
    def moved(self) -> tuple[int, ...]:
        """Which joints moved, from 1."""
        return tuple(i for i, t in enumerate(self.times, 1) if len(t) > 1)


class Window(NamedTuple):
    """Where the base is averaged in a rest [ns]."""

    begin: int
    end: int
    moved: int  # a moment before, at which some joint was moving; -1: none is known


class Motion(NamedTuple):
    """The windows before and after."""

    before: Window
    after: Window

    @property
    def end(self) -> int:
        """Of the window after [ns]."""
        return self.after.end


class ManeuverFinder(Finder[Motion, Maneuver]):
    """Fed samples of n joints, the base and its gyro, gives the maneuvers that they complete.

    The gyro may be absent: it is needed only where the base was not seen for long. So may the end
    effector, which only shows whose arm it is, and the links' telemetry.
    """

    settings: ManeuverSettings

    def __init__(self, n: int, settings: ManeuverSettings | None = None) -> None:
        s = settings or ManeuverSettings()
        super().__init__(n, s, search=0.5)
        self._lag(s.time_offset)
        self._turns = np.zeros(2)  # of gyro and motion capture together, and of the latter alone
        self._before: Rest | None = None  # the rest that the next maneuver begins with

    def _merged(self, ended: Rest | None) -> None:
        if ended and self._window(ended) >= self.min_duration:
            self._propose(ended)
            self._before = ended

    def _window(self, rest: Rest) -> int:
        """How long a window at each end of a rest may last [ns]."""
        return min(self.max_duration, (rest.end - rest.begin - self.settle_time) // 2)

    def _propose(self, rest: Rest) -> bool:
        """A maneuver may end with a rest; one that was solved amid the rest has done so before."""
        before = self._before
        if not before or rest.begin <= before.end:
            return False
        settled = rest.begin + self.settle_time
        departure = Window(before.end - self._window(before), before.end, before.moved)
        arrival = Window(settled, settled + self._window(rest), rest.moved)
        self._pending.append(Motion(departure, arrival))
        return True

    def _collect(self, closing: bool = False) -> list[Maneuver]:
        usable = self.rests.end - self.rests.begin - self.settle_time
        full = self._before and usable >= 2 * self.max_duration
        if closing:
            self._merged(self.rests.present())
        elif full and self._propose(self.rests.present()):
            self._before = None  # the window after a maneuver is known before a long rest is over
        return super()._collect(closing)

    def _segment(self, candidate: Motion, closing: bool) -> Maneuver | None:
        """What happened between two rests; None if no joint moved far enough to be called so."""
        start, end = candidate.before.begin, candidate.end
        if end - start > self.horizon:  # its begin is forgotten
            lasts, most = (end - start) / SECOND, self.settings.horizon
            nothing = ((),) * len(self.joints)
            reason = f"it lasts {lasts:.0f} s, at most {most:g} s are followed"
            return Maneuver(start, end, nothing, nothing, nothing, used=False, reason=reason)
        series = [joint_path(joint, *candidate, self.motion_threshold) for joint in self.joints]
        gaps = [gap for joint in self.joints for gap in self._joint_gaps(joint, candidate)]
        travel = max(float(np.ptp(q)) if len(q) else 0.0 for _, q, _ in series)
        if not gaps and travel < self.settings.min_travel:
            return None
        times, q, qd = (
            tuple(tuple(part.tolist()) for part in parts) for parts in zip(*series, strict=True)
        )
        maneuver = Maneuver(start, end, times, q, qd)
        gaps += self._frozen(candidate)
        if reason := str(gaps[0]) if gaps else self._rejected(maneuver):
            return replace(maneuver, used=False, reason=reason)
        tip = seen_from(self.base, self.tip, start, candidate.before.end)[1]
        if len(tip) > 1:
            maneuver = replace(maneuver, tip=tuple(mean_pose(tip).tolist()))
        maneuver = replace(self._averaged(maneuver, candidate), time_offset=self.base.lag / SECOND)
        self._align(start, end)
        return maneuver

    def _joint_gaps(self, joint: Joint, motion: Motion) -> list[Gap]:
        """Silences of a joint that hide where it went meanwhile."""
        start, end = motion.before.begin, motion.end
        t, q, _ = joint.within(start, end)
        if not len(q):
            return [Gap(start, end, joint.name)]
        moved = np.concatenate([[True], np.abs(np.diff(q)) > self.motion_threshold, [True]])
        t = np.concatenate([[start], t, [end]])
        late = np.flatnonzero((np.diff(t) > self.joint_gap) & moved)
        gaps = [Gap(int(t[k]), int(t[k + 1]), joint.name) for k in late]
        # A joint that rests may be silent for `joint_gap`, which may be longer than a window.
        empty = [w for w in motion if not len(joint.within(w.begin, w.end)[0])]
        return gaps + [Gap(w.begin, w.end, joint.name) for w in empty]

    def _frozen(self, motion: Motion) -> list[Gap]:
        """Windows with poses that the base has had since before the arm came to rest."""
        gaps = []
        for window in motion:
            if number := self.base.frozen(*window):
                self.base.rejected[FROZEN] += number
                gaps.append(Gap(window.begin, window.end, BASE, FROZEN))
        return gaps

    def _rejected(self, maneuver: Maneuver) -> str:
        """What telemetry says against a maneuver; empty: nothing."""
        span = maneuver.start, maneuver.end
        for i, (joint, link) in enumerate(zip(self.joints, self.links, strict=True), 1):
            if link.homed(*span):
                return f"{joint.name} homed or restarted"
            readings = (joint.within(*part)[1] for part in link.disarmed(*span))
            travel = max((float(np.ptp(q)) for q in readings if len(q)), default=0.0)
            if i in maneuver.moved and travel > self.motion_threshold:
                return f"{joint.name} moved while disarmed"
        return ""

    def _averaged(self, maneuver: Maneuver, motion: Motion) -> Maneuver:
        """The maneuver with the base's poses, averaged over bins."""
        t, poses = self.base.within(maneuver.start, maneuver.end)
        step = round(pi / self.settings.max_base_turn * SECOND)
        heading = self.gyro.unwrap(t, poses[:, 2], step, self.vicon_gap)
        if isinstance(heading, tuple):
            return replace(maneuver, used=False, reason=f"{Gap(*heading, BASE)}, and no gyro")
        poses[:, 2], rows = heading, []
        for begin, end, _ in motion:
            seen = list(bins(t, poses, begin, end, self.settings.bin, maneuver.start))
            if not seen:
                return replace(maneuver, used=False, reason=str(Gap(begin, end, BASE)))
            rows += seen
        if rate := self.settings.path_rate:
            way = motion.before.end, motion.after.begin - LOOK
            for begin in range(*way, max(LOOK, round(SECOND / rate))):
                width = LOOK / SECOND
                rows += bins(t, poses, begin, begin + LOOK, width, maneuver.start)
        rows.sort()
        marks, means, frames, seconds = zip(*rows, strict=True)
        return replace(maneuver, marks=marks, poses=means, frames=frames, seconds=seconds)

    def _align(self, begin: int, end: int) -> None:
        """Learn the clocks' offset from how the base turned."""
        turned = self.gyro.angles(begin, end, self.vicon_gap)
        if turned is None or self.base.gaps(begin, end, self.vicon_gap):
            return
        t, poses = self.base.about(begin, end)
        self._compare(turned, t, np.unwrap(poses[:, 2]))
        search = self.alignment.search
        ends = np.array([search, (end - begin) / SECOND - search])
        gyro, seen = (turned[0] - begin) / SECOND, (t - begin) / SECOND
        psi = np.unwrap(poses[:, 2])
        found = offset_of_move(ends, [(gyro, turned[1])], seen, psi, search)
        if found.deviation < inf:
            self._learn(replace(found, value=found.value + self.base.lag / SECOND))

    def _compare(self, turned: tuple[Stamps, Floats], t: Stamps, psi: Floats) -> None:
        """Learn how far the gyro turns as motion capture sees it turn."""
        angle = np.interp(t - t[0], turned[0] - t[0], turned[1])
        a, p = angle - np.mean(angle), psi - np.mean(psi)
        self._turns += [float(a @ p), float(p @ p)]

    def streams(self) -> Streams:
        """With what the gyro says of the base's turns."""
        common, own = self._turns
        ratio = common / own if own > LEAST_SEEN else nan
        return replace(super().streams(), gyro_ratio=ratio)

    def _needed_since(self) -> int:
        rest = self._pending[0].before if self._pending else self._before or self.rests
        return rest.end - 2 * self.max_duration - SECOND


def joint_path(
    joint: Joint, before: Window, after: Window, threshold: float
) -> tuple[Floats, Floats, Floats]:
    """Times from the start [s], readings and rates: at rest, the averages of both windows.

    Of a joint that did not move, one sample; of one without readings at rest, none.
    """
    t, q, qd = joint.within(before.end + 1, after.begin - 1)
    ends = [joint.within(window.begin, window.end)[1] for window in (before, after)]
    if not all(map(len, ends)):
        return np.empty(0), np.empty(0), np.empty(0)
    first, last = (float(np.mean(readings)) for readings in ends)
    if np.abs(np.array([*q, last]) - first).max() <= threshold:
        return np.array([(before.end - before.begin) / SECOND]), np.array([first]), np.zeros(1)
    times = (np.concatenate([[before.end], t, [after.begin]]) - before.begin) / SECOND
    q, qd = np.concatenate([[first], q, [last]]), np.concatenate([[0.0], qd, [0.0]])
    return times, q, np.where(np.isfinite(qd), qd, np.gradient(q, times))
