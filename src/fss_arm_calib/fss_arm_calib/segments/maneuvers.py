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
from math import inf, pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_calib.segments.alignment import estimate_offset
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Joint, Rest
from fss_arm_calib.segments.poses import BASE, FROZEN, average_bins, relative_poses
from fss_arm_calib.segments.samples import Gap
from fss_arm_calib.segments.sensors import Sensors
from fss_arm_calib.segments.settings import ManeuverSettings
from fss_arm_model.arrays import Floats
from fss_arm_model.joint_path import Path, path, sampled
from fss_arm_model.planar import mean_pose
from fss_arm_model.units import SECOND

MIN_TRAVEL = 0.05  # smallest motion of a joint in a maneuver [rad]
MAX_BASE_TURN_RATE = 3.0  # the base could make half a turn in a longer gap of its poses [rad/s]
POSE_AVERAGING_TIME = SECOND // 10  # averaging time of a pose of the base during the motion [ns]


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
    def in_motion(self) -> npt.NDArray[np.bool_]:
        """Mask (m,), True for marks during the motion."""
        moving = [t for t in self.times if len(t) > 1]
        begin = min((t[0] for t in moving), default=inf)
        end = max((t[-1] for t in moving), default=-inf)
        return (np.array(self.marks) > begin) & (np.array(self.marks) < end)

    @property
    def moved_joints(self) -> tuple[int, ...]:
        """Numbers of the joints that moved, from 1."""
        return tuple(i for i, t in enumerate(self.times, 1) if len(t) > 1)


class Window(NamedTuple):
    """Interval of a rest in which the base's poses are averaged [ns]."""

    begin: int
    end: int
    last_motion: int  # last time before at which some joint was moving; -1: not known


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

    def __init__(self, n: int, settings: ManeuverSettings | None = None) -> None:
        s = self.settings = settings or ManeuverSettings()
        super().__init__(Sensors(n, s, search=0.5))
        self.sensors.set_offset(s.time_offset)
        self._rest_before: Rest | None = None  # the rest before the next maneuver

    def candidates(self, ended_rest: Rest | None) -> list[Motion]:
        """Return the motion before a rest that has ended, if it was long enough."""
        if not ended_rest or self._window_length(ended_rest) < self.sensors.min_duration:
            return []
        motion, self._rest_before = self._motion_before(ended_rest), ended_rest
        return [motion] if motion else []

    def current_candidate(self, closing: bool) -> Motion | None:
        """Return the motion before the present rest if the window after it is complete."""
        rests = self.sensors.rests
        if closing:
            return next(iter(self.candidates(rests.current_rest())), None)
        usable = rests.end - rests.begin - self.sensors.settle_time
        if not self._rest_before or usable < 2 * self.sensors.max_duration:
            return None
        if motion := self._motion_before(rests.current_rest()):
            self._rest_before = None
        return motion

    def _window_length(self, rest: Rest) -> int:
        """Return the longest window at each end of a rest [ns]."""
        s = self.sensors
        return min(s.max_duration, (rest.end - rest.begin - s.settle_time) // 2)

    def _motion_before(self, rest: Rest) -> Motion | None:
        """Return the motion that ends with a rest; None if there is no new one."""
        before = self._rest_before
        if not before or rest.begin <= before.end:
            return None
        settled = rest.begin + self.sensors.settle_time
        departure = Window(before.end - self._window_length(before), before.end, before.last_motion)
        arrival = Window(settled, settled + self._window_length(rest), rest.last_motion)
        return Motion(departure, arrival)

    def observe(self, candidate: Motion, closing: bool) -> Maneuver | None:
        """Return the maneuver between two rests; None if no joint moved far enough."""
        s, start, end = self.sensors, candidate.before.begin, candidate.end
        if end - start > s.horizon:  # its first samples are dropped already
            duration, limit = (end - start) / SECOND, self.settings.horizon
            empty = ((),) * len(s.joints)
            reason = f"maneuver takes {duration:.0f} s (at most {limit:g}: see horizon)"
            return Maneuver(start, end, empty, empty, empty, used=False, reason=reason)
        series = [joint_path(joint, *candidate, s.motion_threshold) for joint in s.joints]
        gaps = [gap for joint in s.joints for gap in self._joint_gaps(joint, candidate)]
        travel = max(float(np.ptp(q)) if len(q) else 0.0 for _, q, _ in series)
        if not gaps and travel < MIN_TRAVEL:
            return None
        columns = zip(*series, strict=True)
        times, q, qd = (tuple(tuple(part.tolist()) for part in parts) for parts in columns)
        maneuver = Maneuver(start, end, times, q, qd)
        gaps += self._frozen_windows(candidate)
        if reason := str(gaps[0]) if gaps else self._rejection_reason(maneuver):
            return replace(maneuver, used=False, reason=reason)
        tip = relative_poses(s.base, s.tip, start, candidate.before.end)[1]
        if len(tip) > 1:
            maneuver = replace(maneuver, tip=tuple(mean_pose(tip).tolist()))
        averaged = self._average_poses(maneuver, candidate)
        maneuver = replace(averaged, time_offset=s.base.lag / SECOND)
        self._align_clocks(start, end)
        return maneuver

    def _joint_gaps(self, joint: Joint, motion: Motion) -> list[Gap]:
        """Return the gaps in a joint's readings that hide its motion."""
        s = self.sensors
        start, end = motion.before.begin, motion.end
        t, q, _ = joint.samples_within(start, end)
        if not len(q):
            return [Gap(start, end, joint.name)]
        moving = np.concatenate([[True], np.abs(np.diff(q)) > s.motion_threshold, [True]])
        t = np.concatenate([[start], t, [end]])
        before_gaps = np.flatnonzero((np.diff(t) > s.joint_gap) & moving)
        gaps = [Gap(int(t[k]), int(t[k + 1]), joint.name) for k in before_gaps]
        # A joint at rest may be silent for `joint_gap`, which may be longer than a window.
        empty = [w for w in motion if not len(joint.samples_within(w.begin, w.end)[0])]
        return gaps + [Gap(w.begin, w.end, joint.name) for w in empty]

    def _frozen_windows(self, motion: Motion) -> list[Gap]:
        """Return the windows with frozen poses: unchanged since before the arm came to rest."""
        gaps, base = [], self.sensors.base
        for window in motion:
            if number := base.count_frozen(*window):
                base.rejected[FROZEN] += number
                gaps.append(Gap(window.begin, window.end, BASE, FROZEN))
        return gaps

    def _rejection_reason(self, maneuver: Maneuver) -> str:
        """Return a reason from the telemetry to reject a maneuver; empty if there is none."""
        s = self.sensors
        span = maneuver.start, maneuver.end
        for i, (joint, link) in enumerate(zip(s.joints, s.links, strict=True), 1):
            if link.was_homed(*span):
                return f"{joint.name} homed or restarted"
            readings = (joint.samples_within(*part)[1] for part in link.disarmed_intervals(*span))
            travel = max((float(np.ptp(q)) for q in readings if len(q)), default=0.0)
            if i in maneuver.moved_joints and travel > s.motion_threshold:
                return f"{joint.name} moved while disarmed"
        return ""

    def _average_poses(self, maneuver: Maneuver, motion: Motion) -> Maneuver:
        """Return the maneuver with the base's poses, averaged over bins."""
        s = self.sensors
        t, poses = s.base.samples_within(maneuver.start, maneuver.end)
        step = round(pi / MAX_BASE_TURN_RATE * SECOND)
        heading = s.gyro.unwrap(t, poses[:, 2], step, s.vicon_gap)
        if isinstance(heading, tuple):
            return replace(maneuver, used=False, reason=f"{Gap(*heading, BASE)}, without a gyro")
        poses[:, 2], rows = heading, []
        for begin, end, _ in motion:
            window = list(average_bins(t, poses, begin, end, self.settings.bin, maneuver.start))
            if not window:
                return replace(maneuver, used=False, reason=str(Gap(begin, end, BASE)))
            rows += window
        if rate := self.settings.path_rate:
            width = POSE_AVERAGING_TIME
            limits = motion.before.end, motion.after.begin - width
            for begin in range(*limits, max(width, round(SECOND / rate))):
                span = begin, begin + width
                rows += average_bins(t, poses, *span, width / SECOND, maneuver.start)
        rows.sort()
        marks, means, frames, seconds = zip(*rows, strict=True)
        return replace(maneuver, marks=marks, poses=means, frames=frames, seconds=seconds)

    def _align_clocks(self, begin: int, end: int) -> None:
        """Update the clocks' offset from the rotation of the base."""
        s = self.sensors
        rotation = s.gyro.angles(begin, end, s.vicon_gap)
        if rotation is None or s.base.gaps(begin, end, s.vicon_gap):
            return
        t, poses = s.base.samples_around(begin, end)
        psi = np.unwrap(poses[:, 2])
        s.gyro.compare(rotation, t, psi)
        search = s.alignment.search
        ends = np.array([search, (end - begin) / SECOND - search])
        gyro, stamps = (rotation[0] - begin) / SECOND, (t - begin) / SECOND
        offset = estimate_offset(ends, [(gyro, rotation[1])], stamps, psi, search)
        if offset.deviation < inf:
            s.update_offset(replace(offset, value=offset.value + s.base.lag / SECOND))

    def oldest_needed(self, next_candidate: Motion | None) -> int:
        """Return the start of the window before the next maneuver, with a margin [ns]."""
        rest = next_candidate.before if next_candidate else self._rest_before or self.sensors.rests
        return rest.end - 2 * self.sensors.max_duration - SECOND


def joint_path(
    joint: Joint, before: Window, after: Window, threshold: float
) -> tuple[Floats, Floats, Floats]:
    """Return times since the start [s], readings and rates, with the window averages at the ends.

    A joint that did not move has one sample; a joint without readings at rest has none.
    """
    t, q, qd = joint.samples_within(before.end + 1, after.begin - 1)
    ends = [joint.samples_within(window.begin, window.end)[1] for window in (before, after)]
    if not all(map(len, ends)):
        return np.empty(0), np.empty(0), np.empty(0)
    first, last = (float(np.mean(readings)) for readings in ends)
    if np.abs(np.array([*q, last]) - first).max() <= threshold:
        return np.array([(before.end - before.begin) / SECOND]), np.array([first]), np.zeros(1)
    times = (np.concatenate([[before.end], t, [after.begin]]) - before.begin) / SECOND
    q, qd = np.concatenate([[first], q, [last]]), np.concatenate([[0.0], qd, [0.0]])
    return times, q, np.where(np.isfinite(qd), qd, np.gradient(q, times))
