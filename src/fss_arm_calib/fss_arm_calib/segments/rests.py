"""Observations found in streams: the rests of the arm, and the average of each rest.

An arm rests while every joint's readings stay within the motion threshold of each other. After it
has settled, the first interval of `max_duration` without a gap in any stream becomes one
Observation. If the arm moves earlier, it is the longest such interval of at least `min_duration`.
There is one observation for each rest, no matter what moved the arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from fss_arm_calib.segments.alignment import MAX_MOVE_DURATION, estimate_offset, find_last_move
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Rest
from fss_arm_calib.segments.poses import (
    BASE,
    FROZEN,
    JUMP,
    TIP,
    mean_pose,
    near_median,
    relative_poses,
)
from fss_arm_calib.segments.samples import SECOND, Gap, parts_outside
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.telemetry import keep_since_homing, rehomed_joints
from fss_arm_model.planar import wrap

__all__ = [
    "BASE",
    "TIP",
    "Observation",
    "RestFinder",
    "keep_since_homing",
    "rehomed_joints",
    "rejected_without_repeat",
]

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
    """Return the rejected observations for which no observation of the same posture is used.

    Postures are the same if all readings agree within `tolerance` [rad].
    """
    postures = [np.array(o.q) for o in observations if o.used]
    return [
        o
        for o in observations
        if not o.used and not any(np.all(np.abs(q - o.q) <= tolerance) for q in postures)
    ]


class RestFinder(Finder[Rest, Observation]):
    """Finder of observations in the samples of n joints and two subjects.

    Args:
        n: number of joints.
        settings: definition of a rest.
        resting_at: (n) posture of the last observation before the finder was started; if the arm
            has not moved since, it is not observed again.
    """

    needed = (BASE, TIP)

    def __init__(
        self,
        n: int,
        settings: RestSettings | None = None,
        resting_at: Sequence[float] | None = None,
    ) -> None:
        s = settings or RestSettings()
        super().__init__(n, s, search=s.settle_time + s.min_duration)
        self._is_observed = False  # True if the current rest has been observed
        self._last_gap_end = 0  # end of the last known gap in the current rest [ns]
        self._aligned_rest = 0  # start of the last rest for which the clocks were aligned [ns]
        self._resting_at = resting_at

    def _process_reading(self, ended_rest: Rest | None) -> None:
        if ended_rest:
            if not self._is_observed_already(ended_rest) and (
                rest := self._remove_settling(ended_rest)
            ):
                self._pending.append(rest)
            self._is_observed, self._resting_at, self._last_gap_end = False, None, 0

    def _is_observed_already(self, rest: Rest) -> bool:
        """Return True if the current rest needs no further observation."""
        q = self._resting_at
        return self._is_observed or (q is not None and rest.matches(q, 2.0 * self.motion_threshold))

    def _remove_settling(self, rest: Rest) -> Rest | None:
        """Return the rest without the time to settle, or None if it is too short.

        If a joint was silent before it moved, the rest extends to the motion.
        """
        end = rest.moved_at if rest.moved_at - rest.end > self.joint_gap else rest.end
        begin = rest.begin + self.settle_time
        return rest._replace(begin=begin, end=end) if rest.end > begin else None

    def _collect(self, closing: bool = False) -> list[Observation]:
        found = super()._collect(closing)
        if not self._pending and (observation := self._observe_current_rest(closing)):
            self._is_observed = True
            found.append(observation)
        return found

    def _observe_current_rest(self, closing: bool) -> Observation | None:
        """Return the observation of the current rest if it is long enough, or if closing."""
        begin = self.rests.begin + self.settle_time
        too_short = self.rests.end - begin < self.min_duration and not closing
        if too_short or (self._is_observed and self._aligned_rest == begin):
            return None
        self._align_clocks(begin, self.rests.end)
        # Cheap test, without arrays, whether the rest can contain an interval of full length.
        until = min(self._received_until, self.rests.end)
        if not closing and until - max(begin, self._last_gap_end) < self.max_duration:
            return None
        rest = self.rests.current_rest(self.rests.newest if closing else -1)
        settled = None if self._is_observed_already(rest) else self._remove_settling(rest)
        if not settled:
            return None
        return self._observe(settled if closing else settled._replace(end=until), is_over=closing)

    def _is_complete(self, candidate: Rest) -> bool:
        if not super()._is_complete(candidate):
            return False
        self._align_clocks(candidate.begin, candidate.end)
        return super()._is_complete(candidate)  # with the new offset

    def _segment(self, candidate: Rest, closing: bool) -> Observation | None:
        self._align_clocks(candidate.begin, candidate.end)
        timed_out = [p for p in self._needed_poses if p.received_until < candidate.end]
        missing = [Gap(p.received_until, candidate.end, p.name) for p in timed_out if not closing]
        return self._observe(candidate, is_over=True, missing=missing)

    def _align_clocks(self, begin: int, end: int) -> None:
        """Update the clocks' offset from the move before a rest that all streams have passed."""
        required = begin + self.min_duration
        if self._aligned_rest == begin or min(end, self._poses_received_until) < required:
            return
        self._aligned_rest = begin
        move = find_last_move(self.joints, begin - self.settle_time, self.motion_threshold)
        if not move:
            return
        search = round(self.alignment.search * SECOND)
        first, last = move[0] - search, max(move[1] + search, required)
        if any(poses.gaps(first, last, self.vicon_gap) for poses in self._needed_poses):
            return
        t, poses = relative_poses(self.base, self.tip, first, last)
        q = [joint.samples_within(first, required)[:2] for joint in self.joints]
        if len(t) < 2 or any(len(stamps) < 3 for stamps, _ in q):
            return
        ends = np.array([0.0, (move[1] - move[0]) / SECOND])
        paths = [((stamps - move[0]) / SECOND, readings) for stamps, readings in q]
        frames, psi = (t - self.base.lag - move[0]) / SECOND, np.unwrap(poses[:, 2])
        self._update_offset(estimate_offset(ends, paths, frames, psi, self.alignment.search))

    def _observe(
        self, rest: Rest, is_over: bool, missing: Sequence[Gap] = ()
    ) -> Observation | None:
        """Return the observation of a rest; None if it is too short, or can still become longer."""
        # A stream that has not started is no gap. Samples older than the horizon may be dropped.
        started = max(poses.first_stamp + poses.lag for poses in self._needed_poses)
        begin = max(rest.begin, started, rest.end - self.horizon - self.max_duration)
        if rest.end - begin < self.min_duration or any(
            p.first_stamp < 0 for p in self._needed_poses
        ):
            return None
        gaps = [g for joint in self.joints for g in joint.gaps(begin, rest.end, self.joint_gap)]
        gaps += [gap for gap in missing if gap.end > begin]
        for poses in self._needed_poses:
            gaps += poses.gaps(begin, rest.end, self.vicon_gap, rest.last_motion)
        pieces = parts_outside(begin, rest.end, gaps)
        whole = [(a, a + self.max_duration) for a, b in pieces if b - a >= self.max_duration]
        if not whole and is_over:
            best = max(pieces, key=lambda piece: piece[1] - piece[0], default=(0, 0))
            whole = [best] if best[1] - best[0] >= self.min_duration else []
        if not whole and not is_over:
            self._last_gap_end = max(gap.end for gap in gaps) if gaps else begin
            return None
        for poses in self._needed_poses:
            poses.rejected[FROZEN] += poses.count_frozen(begin, rest.end, rest.last_motion)
        if whole:
            return self._average(rest, *whole[0])
        # Do not report gaps beyond the rest: samples there may be dropped, or not received yet.
        inside = [
            gap._replace(start=max(gap.start, begin), end=min(gap.end, rest.end)) for gap in gaps
        ]
        return self._reject(rest, str(max(inside, key=lambda gap: gap.end - gap.start)))

    def _average(self, rest: Rest, begin: int, end: int) -> Observation:
        """Average an interval of a rest that has no gaps."""
        readings = [joint.samples_within(begin, end)[1] for joint in self.joints]
        for joint, q in zip(self.joints, readings, strict=True):
            if not len(q):
                return self._reject(rest, f"no reading of {joint.name}")
        poses = relative_poses(self.base, self.tip, begin, end, rest.last_motion)[1]
        if len(poses) < 2:
            return self._reject(rest, "fewer than 2 pairs of poses")
        consistent = near_median(poses)
        self.tip.rejected[JUMP] += int(np.sum(~consistent))
        if np.mean(consistent) < 1.0 - MAX_JUMP_SHARE:
            return self._reject(rest, "poses contradict each other")
        poses = poses[consistent]
        mean = mean_pose(poses)
        errors = poses - mean
        errors[:, 2] = wrap(errors[:, 2])
        boots, homings = self._references(end)
        return Observation(
            start=begin,
            end=end,
            q=tuple(float(q.mean()) for q in readings),
            tip=tuple(mean.tolist()),
            scatter=tuple(np.sqrt(np.sum(errors**2, axis=0) / (len(errors) - 1)).tolist()),
            joint_samples=min(map(len, readings)),
            vicon_frames=len(poses),
            time_offset=self.base.lag / SECOND,
            boots=boots,
            homings=homings,
        )

    def _reject(self, rest: Rest, reason: str) -> Observation:
        boots, homings = self._references(rest.end)
        return Observation(
            rest.begin, rest.end, rest.q, boots=boots, homings=homings, used=False, reason=reason
        )

    def _oldest_needed(self) -> int:
        since = self._pending[0].begin if self._pending else self.rests.end
        if not self._is_observed:
            since = min(since, self.rests.begin)
        # The move before a rest is needed to align the clocks.
        return since - round((MAX_MOVE_DURATION + 2.0 * self.alignment.search) * SECOND)
