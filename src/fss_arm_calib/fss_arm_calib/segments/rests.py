"""Observations found in streams: the rests of the arm, and the average of each rest.

An arm rests while every joint's readings stay within the motion threshold of each other. After it
has settled, the first interval of `max_duration` without a gap in any stream becomes one
Observation. If the arm moves earlier, it is the longest such interval of at least `min_duration`.
There is one observation for each rest, no matter what moved the arm. A rest that follows an
observed one is not observed if no joint has moved by more than SAME_POSTURE since: most errors of
motion capture stay as long as the arm stays, so it would count them twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, radians

import numpy as np

from fss_arm_calib.segments.alignment import MAX_MOVE_DURATION, estimate_offset, find_last_move
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Rest
from fss_arm_calib.segments.poses import (
    BASE,
    FROZEN,
    JUMP,
    TIP,
    near_median,
    relative_poses,
)
from fss_arm_calib.segments.samples import Gap, parts_outside
from fss_arm_calib.segments.sensors import Sensors
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_model.planar import mean_pose, wrap
from fss_arm_model.units import SECOND

SAME_POSTURE = radians(1.0)  # largest difference of a joint between equal postures [rad]
MAX_JUMP_SHARE = 0.1  # largest share of a rest's poses that are rejected as jumps


@dataclass(frozen=True)
class Observation:
    """Rest of the arm: pose of the end effector in the base's frame, and readings of the joints."""

    start: int  # start of the averaged interval [ns]
    end: int
    q: tuple[float, ...]  # (n) averaged readings [rad]
    tip: tuple[float, ...] = (nan, nan, nan)  # end effector in the base's frame [m, m, rad]
    scatter: tuple[float, ...] = (nan, nan, nan)  # standard deviation of frames
    joint_samples: int = 0  # smallest number of readings averaged of a joint
    vicon_frames: int = 0  # number of pairs of poses averaged
    time_offset: float = 0.0  # joints' stamps minus motion capture's, as corrected for [s]
    boots: tuple[int, ...] = ()  # (n) start of each link's electronics; 0: not known
    homings: tuple[int, ...] = ()  # (n) homings of each drive since then; 0: not known
    used: bool = True
    reason: str = ""  # why it is not used


def rejected_without_repeat(
    observations: Sequence[Observation], tolerance: float
) -> list[Observation]:
    """Return the rejected observations without a used one of the same posture [rad]."""
    postures = [np.array(o.q) for o in observations if o.used]

    def is_repeated(o: Observation) -> bool:
        return any(np.all(np.abs(q - o.q) <= tolerance) for q in postures)

    return [o for o in observations if not o.used and not is_repeated(o)]


def average_rest(s: Sensors, rest: Rest, begin: int, end: int) -> Observation:
    """Average an interval of a rest that has no gaps."""
    readings = [joint.samples_within(begin, end)[1] for joint in s.joints]
    for joint, q in zip(s.joints, readings, strict=True):
        if not len(q):
            return reject_rest(s, rest, f"no reading of {joint.name}")
    poses = relative_poses(s.base, s.tip, begin, end, rest.last_motion)[1]
    if len(poses) < 2:
        return reject_rest(s, rest, "fewer than 2 pairs of poses")
    consistent = near_median(poses)
    s.tip.rejected[JUMP] += int(np.sum(~consistent))
    if np.mean(consistent) < 1.0 - MAX_JUMP_SHARE:
        return reject_rest(s, rest, "poses contradict each other")
    poses = poses[consistent]
    mean = mean_pose(poses)
    errors = poses - mean
    errors[:, 2] = wrap(errors[:, 2])
    boots, homings = s.references(end)
    return Observation(
        start=begin,
        end=end,
        q=tuple(float(q.mean()) for q in readings),
        tip=tuple(mean.tolist()),
        scatter=tuple(np.sqrt(np.sum(errors**2, axis=0) / (len(errors) - 1)).tolist()),
        joint_samples=min(map(len, readings)),
        vicon_frames=len(poses),
        time_offset=s.base.lag / SECOND,
        boots=boots,
        homings=homings,
    )


def reject_rest(s: Sensors, rest: Rest, reason: str) -> Observation:
    """Return a rest as an observation that is not used."""
    boots, homings = s.references(rest.end)
    return Observation(
        rest.begin, rest.end, rest.q, boots=boots, homings=homings, used=False, reason=reason
    )


class RestFinder(Finder[Rest, Observation]):
    """Finder of observations, intervals at rest without a gap, for n joints and two subjects.

    The present rest is observed as soon as it contains an interval of full length. If the arm has
    not left `resting_at` (n), the posture of the last observation before the start, it is not
    observed again.
    """

    def __init__(
        self,
        n: int,
        settings: RestSettings | None = None,
        resting_at: Sequence[float] | None = None,
    ) -> None:
        s = settings or RestSettings()
        super().__init__(Sensors(n, s, (BASE, TIP), search=s.settle_time + s.min_duration))
        self._is_observed = False  # True if the current rest has been observed
        self._last_gap_end = 0  # end of the last known gap in the current rest [ns]
        self._aligned_rest = 0  # start of the last rest for which the clocks were aligned [ns]
        self._posture = resting_at  # (n) of the last rest, until the arm leaves it [rad]
        self._is_used = resting_at is not None  # True if there is a used observation of it

    def candidates(self, ended_rest: Rest | None) -> list[Rest]:
        """Return a rest that has ended, unless it has been observed."""
        if not ended_rest:
            return []
        rest = self._remaining_rest(ended_rest)
        if self._is_new(ended_rest):
            self._posture = ended_rest.q if rest or self._is_observed else None
        self._is_observed, self._last_gap_end = False, 0
        return [rest] if rest else []

    def _remaining_rest(self, rest: Rest) -> Rest | None:
        """Return the rest without the time to settle; None if it is too short or observed already.

        If a joint was silent before it moved, the rest extends to the motion.
        """
        s = self.sensors
        if self._is_observed:
            return None
        end = rest.moved_at if rest.moved_at - rest.end > s.joint_gap else rest.end
        begin, is_new = rest.begin + s.settle_time, self._is_new(rest)
        return rest._replace(begin=begin, end=end, is_new=is_new) if rest.end > begin else None

    def _is_new(self, rest: Rest) -> bool:
        """Return True if the arm has left the posture of the rest before."""
        return self._posture is None or not rest.matches(self._posture, SAME_POSTURE)

    def current_candidate(self, closing: bool) -> Rest | None:
        """Return the present rest if it is long enough, or if closing."""
        s, rests = self.sensors, self.sensors.rests
        begin = rests.begin + s.settle_time
        too_short = rests.end - begin < s.min_duration and not closing
        if too_short or (self._is_observed and self._aligned_rest == begin):
            return None
        self._align_clocks(begin, rests.end)
        # Cheap test, without arrays, whether the rest can contain an interval of full length.
        until = min(s.received_until, rests.end)
        if not closing and until - max(begin, self._last_gap_end) < s.max_duration:
            return None
        rest = self._remaining_rest(rests.current_rest(rests.newest if closing else -1))
        if not rest:
            return None
        return rest._replace(end=rest.end if closing else until, has_ended=False)

    def align(self, candidate: Rest) -> None:
        """Update the offset between the clocks from the move before a rest."""
        self._align_clocks(candidate.begin, candidate.end)

    def _align_clocks(self, begin: int, end: int) -> None:
        """Update the clocks' offset from the move before a rest that all streams have passed."""
        s, required = self.sensors, begin + self.sensors.min_duration
        if self._aligned_rest == begin or min(end, s.poses_received_until) < required:
            return
        self._aligned_rest = begin
        move = find_last_move(s.joints, begin - s.settle_time, s.motion_threshold)
        if not move:
            return
        search = round(s.alignment.search * SECOND)
        first, last = move[0] - search, max(move[1] + search, required)
        if any(poses.gaps(first, last, s.vicon_gap) for poses in s.needed_poses):
            return
        t, poses = relative_poses(s.base, s.tip, first, last)
        q = [joint.samples_within(first, required)[:2] for joint in s.joints]
        if len(t) < 2 or any(len(stamps) < 3 for stamps, _ in q):
            return
        ends = np.array([0.0, (move[1] - move[0]) / SECOND])
        paths = [((stamps - move[0]) / SECOND, readings) for stamps, readings in q]
        frames, psi = (t - s.base.lag - move[0]) / SECOND, np.unwrap(poses[:, 2])
        s.update_offset(estimate_offset(ends, paths, frames, psi, s.alignment.search))

    def observe(self, candidate: Rest, closing: bool) -> Observation | None:
        """Return the observation of a rest; None if it is too short, or can still become longer."""
        s, end, is_over = self.sensors, candidate.end, closing or candidate.has_ended
        self._is_used = self._is_used and not candidate.is_new
        if self._is_used:
            self._is_observed = self._is_observed or not candidate.has_ended
            return None
        # A stream that has not started is no gap. Samples older than the horizon may be dropped.
        started = max(poses.first_stamp + poses.lag for poses in s.needed_poses)
        begin = max(candidate.begin, started, end - s.horizon - s.max_duration)
        if end - begin < s.min_duration or any(p.first_stamp < 0 for p in s.needed_poses):
            return None
        gaps = [gap for joint in s.joints for gap in joint.gaps(begin, end, s.joint_gap)]
        timed_out = [p for p in s.needed_poses if p.received_until < end and not closing]
        gaps += [Gap(poses.received_until, end, poses.name) for poses in timed_out]
        for poses in s.needed_poses:
            gaps += poses.gaps(begin, end, s.vicon_gap, candidate.last_motion)
        pieces = parts_outside(begin, end, gaps)
        whole = [(a, a + s.max_duration) for a, b in pieces if b - a >= s.max_duration]
        if not whole and is_over:
            best = max(pieces, key=lambda piece: piece[1] - piece[0], default=(0, 0))
            whole = [best] if best[1] - best[0] >= s.min_duration else []
        if not whole and not is_over:
            self._last_gap_end = max(gap.end for gap in gaps) if gaps else begin
            return None
        for poses in s.needed_poses:
            poses.rejected[FROZEN] += poses.count_frozen(begin, end, candidate.last_motion)
        self._is_observed = self._is_observed or not candidate.has_ended
        if whole:
            found = average_rest(s, candidate, *whole[0])
            self._is_used = found.used
            return found
        # Do not report gaps beyond the rest: samples there may be dropped, or not received yet.
        inside = [gap._replace(start=max(gap.start, begin), end=min(gap.end, end)) for gap in gaps]
        longest = max(inside, key=lambda gap: gap.end - gap.start)
        return reject_rest(s, candidate, str(longest))

    def oldest_needed(self, next_candidate: Rest | None) -> int:
        """Return a time before the move that aligns the clocks for the next rest [ns]."""
        rests = self.sensors.rests
        since = next_candidate.begin if next_candidate else rests.end
        if not self._is_observed:
            since = min(since, rests.begin)
        search = self.sensors.alignment.search
        return since - round((MAX_MOVE_DURATION + 2.0 * search) * SECOND)
