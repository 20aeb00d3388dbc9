"""Maneuvers found in streams: the arm rests, moves and rests again, and the base reacts.

A pause that is too short to settle and for two windows is part of the motion. The second half of a
rest, up to `max_duration`, is the window before the next maneuver. The first half is the window
after the last one, so that no pose counts twice. In a window the base may drift, so its poses are
averaged over short bins, each a knot of the path.

A joint that moves while its link reports that it is not armed is moved by hand. The operator then
holds the base, and its motion contains no information about the arm.

The base's rotation by its gyro and by motion capture gives the offset between their clocks; the
gyro's stamps are of the joints' clock. The offset known at that time shifts the windows that
follow.
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

LOOK = SECOND // 10  # averaging time of a pose of the base during the motion [ns]
LEAST_SEEN = 1.0  # sum of squared base angles needed for a gyro ratio, over all frames [rad^2]


@dataclass(frozen=True)
class Maneuver:
    """Motion of the arm between two rests, and the motion of the base."""

    start: int  # start of the window before [ns]
    end: int  # end of the window after
    times: tuple[tuple[float, ...], ...]  # (n) times of each joint's samples since `start` [s]
    q: tuple[tuple[float, ...], ...]  # (n) readings at these times [rad]; first and last at rest
    qd: tuple[tuple[float, ...], ...]  # (n) rates at these times [rad/s]
    marks: tuple[float, ...] = ()  # (m) times of the base's averaged poses since `start` [s]
    poses: tuple[tuple[float, ...], ...] = ()  # (m) x, y [m], unwrapped heading [rad]
    frames: tuple[int, ...] = ()  # (m) number of frames averaged
    seconds: tuple[float, ...] = ()  # (m) averaging time [s]
    tip: tuple[float, ...] = ()  # end effector in the base's frame, before [m, m, rad]
    time_offset: float = 0.0  # joints' stamps minus motion capture's, as corrected for [s]
    used: bool = True
    reason: str = ""  # why it is not used

    @cached_property
    def path(self) -> Path:
        """Path of the joints, with marks at the times of the base's poses."""
        return self.path_at(self.marks)

    def path_at(self, marks: npt.ArrayLike) -> Path:
        """Return the joints' path with other marks, (k,) times since `start` [s]."""
        law, edges = sampled(self.times, self.q, self.qd)
        return path(law, edges, marks)

    @property
    def underway(self) -> npt.NDArray[np.bool_]:
        """Mask (m,), True for marks during the motion."""
        ways = [t for t in self.times if len(t) > 1]
        begin, end = (min(t[0] for t in ways), max(t[-1] for t in ways)) if ways else (inf, -inf)
        return (np.array(self.marks) > begin) & (np.array(self.marks) < end)

    @property
    def moved(self) -> tuple[int, ...]:
        """Numbers of the joints that moved, from 1."""
        return tuple(i for i, t in enumerate(self.times, 1) if len(t) > 1)


class Window(NamedTuple):
    """Interval of a rest in which the base's poses are averaged [ns]."""

    begin: int
    end: int
    moved: int  # last time before at which some joint was moving; -1: not known


class Motion(NamedTuple):
    """Windows before and after a motion."""

    before: Window
    after: Window

    @property
    def end(self) -> int:
        """End of the window after the motion [ns]."""
        return self.after.end


class ManeuverFinder(Finder[Motion, Maneuver]):
    """Finder of maneuvers in the samples of n joints, the base and its gyro.

    The gyro is optional: it is needed only where the base was not seen for long. Also optional are
    the end effector, which only identifies the arm, and the links' telemetry.
    """

    settings: ManeuverSettings

    def __init__(self, n: int, settings: ManeuverSettings | None = None) -> None:
        s = settings or ManeuverSettings()
        super().__init__(n, s, search=0.5)
        self._lag(s.time_offset)
        self._turns = np.zeros(2)  # sums of gyro * motion capture and motion capture^2 [rad^2]
        self._before: Rest | None = None  # the rest before the next maneuver

    def _merged(self, ended: Rest | None) -> None:
        if ended and self._window(ended) >= self.min_duration:
            self._propose(ended)
            self._before = ended

    def _window(self, rest: Rest) -> int:
        """Return the longest window at each end of a rest [ns]."""
        return min(self.max_duration, (rest.end - rest.begin - self.settle_time) // 2)

    def _propose(self, rest: Rest) -> bool:
        """Queue the maneuver that ends with a rest; return False if there is no new one."""
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
            self._before = None  # a long rest need not end: the window after is complete
        return super()._collect(closing)

    def _segment(self, candidate: Motion, closing: bool) -> Maneuver | None:
        """Return the maneuver between two rests; None if no joint moved far enough."""
        start, end = candidate.before.begin, candidate.end
        if end - start > self.horizon:  # its first samples are dropped already
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
        """Return the gaps in a joint's readings that hide its motion."""
        start, end = motion.before.begin, motion.end
        t, q, _ = joint.within(start, end)
        if not len(q):
            return [Gap(start, end, joint.name)]
        moved = np.concatenate([[True], np.abs(np.diff(q)) > self.motion_threshold, [True]])
        t = np.concatenate([[start], t, [end]])
        late = np.flatnonzero((np.diff(t) > self.joint_gap) & moved)
        gaps = [Gap(int(t[k]), int(t[k + 1]), joint.name) for k in late]
        # A joint at rest may be silent for `joint_gap`, which may be longer than a window.
        empty = [w for w in motion if not len(joint.within(w.begin, w.end)[0])]
        return gaps + [Gap(w.begin, w.end, joint.name) for w in empty]

    def _frozen(self, motion: Motion) -> list[Gap]:
        """Return the windows with frozen poses: unchanged since before the arm came to rest."""
        gaps = []
        for window in motion:
            if number := self.base.frozen(*window):
                self.base.rejected[FROZEN] += number
                gaps.append(Gap(window.begin, window.end, BASE, FROZEN))
        return gaps

    def _rejected(self, maneuver: Maneuver) -> str:
        """Return a reason from the telemetry to reject a maneuver; empty if there is none."""
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
        """Return the maneuver with the base's poses, averaged over bins."""
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
        """Update the clocks' offset from the rotation of the base."""
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
        """Update the ratio of the base's rotation by the gyro to that by motion capture."""
        angle = np.interp(t - t[0], turned[0] - t[0], turned[1])
        a, p = angle - np.mean(angle), psi - np.mean(psi)
        self._turns += [float(a @ p), float(p @ p)]

    def streams(self) -> Streams:
        """Return the state of the streams, with the gyro ratio."""
        common, own = self._turns
        ratio = common / own if own > LEAST_SEEN else nan
        return replace(super().streams(), gyro_ratio=ratio)

    def _needed_since(self) -> int:
        rest = self._pending[0].before if self._pending else self._before or self.rests
        return rest.end - 2 * self.max_duration - SECOND


def joint_path(
    joint: Joint, before: Window, after: Window, threshold: float
) -> tuple[Floats, Floats, Floats]:
    """Return times since the start [s], readings and rates, with the window averages at the ends.

    A joint that did not move has one sample; a joint without readings at rest has none.
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
