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

from fss_arm_calib.segments.alignment import LONGEST_MOVE, last_move, offset_of_move
from fss_arm_calib.segments.finder import Finder
from fss_arm_calib.segments.joints import Rest
from fss_arm_calib.segments.poses import (
    BASE,
    FROZEN,
    JUMP,
    TIP,
    mean_pose,
    near_most,
    seen_from,
)
from fss_arm_calib.segments.samples import SECOND, Gap, between
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.telemetry import homed, since_homed
from fss_arm_model.planar import wrap

__all__ = ["BASE", "TIP", "Observation", "RestFinder", "homed", "since_homed", "unrepeated"]

MOST_CONTRADICTING = 0.1  # share of a rest's poses that may be rejected as jumps


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


def unrepeated(observations: Sequence[Observation], tolerance: float) -> list[Observation]:
    """Return the rejected observations without a used one of the same posture.

    Postures are the same if all readings agree within `tolerance` [rad].
    """
    seen = [np.array(o.q) for o in observations if o.used]
    return [
        o
        for o in observations
        if not o.used and not any(np.all(np.abs(q - o.q) <= tolerance) for q in seen)
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
        self._observed = False  # the present rest has been observed
        self._whole_since = 0  # end of the last known gap in the present rest
        self._aligned = 0  # start of the last rest that the clocks were aligned for
        self._resting_at = resting_at

    def _merged(self, ended: Rest | None) -> None:
        if ended:
            if not self._done(ended) and (rest := self._settled(ended)):
                self._pending.append(rest)
            self._observed, self._resting_at, self._whole_since = False, None, 0

    def _done(self, rest: Rest) -> bool:
        """Return True if the present rest needs no further observation."""
        at = self._resting_at
        return self._observed or (at is not None and rest.near(at, 2.0 * self.motion_threshold))

    def _settled(self, rest: Rest) -> Rest | None:
        """Return the rest without the time to settle, or None if it is too short.

        If a joint was silent before it moved, the rest extends to the motion.
        """
        end = rest.until if rest.until - rest.end > self.joint_gap else rest.end
        begin = rest.begin + self.settle_time
        return rest._replace(begin=begin, end=end) if rest.end > begin else None

    def _collect(self, closing: bool = False) -> list[Observation]:
        found = super()._collect(closing)
        if not self._pending and (observation := self._observe_present(closing)):
            self._observed = True
            found.append(observation)
        return found

    def _observe_present(self, closing: bool) -> Observation | None:
        """Return the observation of the present rest if it is long enough, or if closing."""
        begin = self.rests.begin + self.settle_time
        early = self.rests.end - begin < self.min_duration and not closing
        if early or (self._observed and self._aligned == begin):
            return None
        self._align(begin, self.rests.end)
        # Cheap test, without arrays, whether the rest can contain an interval of full length.
        until = min(self._heard, self.rests.end)
        if not closing and until - max(begin, self._whole_since) < self.max_duration:
            return None
        rest = self.rests.present(self.rests.newest if closing else -1)
        settled = None if self._done(rest) else self._settled(rest)
        if not settled:
            return None
        return self._observe(settled if closing else settled._replace(end=until), over=closing)

    def _decided(self, candidate: Rest) -> bool:
        if not super()._decided(candidate):
            return False
        self._align(candidate.begin, candidate.end)
        return super()._decided(candidate)  # with the new offset

    def _segment(self, candidate: Rest, closing: bool) -> Observation | None:
        self._align(candidate.begin, candidate.end)
        given_up = [p for p in self._poses if p.reached < candidate.end and not closing]
        missing = [Gap(poses.reached, candidate.end, poses.name) for poses in given_up]
        return self._observe(candidate, over=True, missing=missing)

    def _align(self, begin: int, end: int) -> None:
        """Update the clocks' offset from the move before a rest that all streams have passed."""
        heard = begin + self.min_duration
        if self._aligned == begin or min(end, self._seen) < heard:
            return
        self._aligned = begin
        move = last_move(self.joints, begin - self.settle_time, self.motion_threshold)
        if not move:
            return
        search = round(self.alignment.search * SECOND)
        first, last = move[0] - search, max(move[1] + search, heard)
        if any(poses.gaps(first, last, self.vicon_gap) for poses in self._poses):
            return
        t, seen = seen_from(self.base, self.tip, first, last)
        q = [joint.within(first, heard)[:2] for joint in self.joints]
        if len(t) < 2 or any(len(stamps) < 3 for stamps, _ in q):
            return
        ends = np.array([0.0, (move[1] - move[0]) / SECOND])
        paths = [((stamps - move[0]) / SECOND, readings) for stamps, readings in q]
        frames, psi = (t - self.base.lag - move[0]) / SECOND, np.unwrap(seen[:, 2])
        self._learn(offset_of_move(ends, paths, frames, psi, self.alignment.search))

    def _observe(self, rest: Rest, over: bool, missing: Sequence[Gap] = ()) -> Observation | None:
        """Return the observation of a rest; None if it is too short, or can still become longer."""
        # A stream that has not started is no gap. Samples older than the horizon may be dropped.
        begun = max(poses.first + poses.lag for poses in self._poses)
        begin = max(rest.begin, begun, rest.end - self.horizon - self.max_duration)
        if rest.end - begin < self.min_duration or any(p.first < 0 for p in self._poses):
            return None
        gaps = [g for joint in self.joints for g in joint.gaps(begin, rest.end, self.joint_gap)]
        gaps += [gap for gap in missing if gap.end > begin]
        for poses in self._poses:
            gaps += poses.gaps(begin, rest.end, self.vicon_gap, rest.moved)
        pieces = between(begin, rest.end, gaps)
        whole = [(a, a + self.max_duration) for a, b in pieces if b - a >= self.max_duration]
        if not whole and over:
            best = max(pieces, key=lambda piece: piece[1] - piece[0], default=(0, 0))
            whole = [best] if best[1] - best[0] >= self.min_duration else []
        if not whole and not over:
            self._whole_since = max(gap.end for gap in gaps) if gaps else begin
            return None
        for poses in self._poses:
            poses.rejected[FROZEN] += poses.frozen(begin, rest.end, rest.moved)
        if whole:
            return self._average(rest, *whole[0])
        # Do not report gaps beyond the rest: samples there may be dropped, or not received yet.
        inside = [
            gap._replace(start=max(gap.start, begin), end=min(gap.end, rest.end)) for gap in gaps
        ]
        return self._unused(rest, str(max(inside, key=lambda gap: gap.end - gap.start)))

    def _average(self, rest: Rest, begin: int, end: int) -> Observation:
        """Average an interval of a rest that has no gaps."""
        readings = [joint.within(begin, end)[1] for joint in self.joints]
        for joint, q in zip(self.joints, readings, strict=True):
            if not len(q):
                return self._unused(rest, f"no reading of {joint.name}")
        seen = seen_from(self.base, self.tip, begin, end, rest.moved)[1]
        if len(seen) < 2:
            return self._unused(rest, "fewer than 2 pairs of poses")
        together = near_most(seen)
        self.tip.rejected[JUMP] += int(np.sum(~together))
        if np.mean(together) < 1.0 - MOST_CONTRADICTING:
            return self._unused(rest, "poses contradict each other")
        seen = seen[together]
        mean = mean_pose(seen)
        away = seen - mean
        away[:, 2] = wrap(away[:, 2])
        boots, homings = self._references(end)
        return Observation(
            start=begin,
            end=end,
            q=tuple(float(q.mean()) for q in readings),
            tip=tuple(mean.tolist()),
            scatter=tuple(np.sqrt(np.sum(away**2, axis=0) / (len(away) - 1)).tolist()),
            joint_samples=min(map(len, readings)),
            vicon_frames=len(seen),
            time_offset=self.base.lag / SECOND,
            boots=boots,
            homings=homings,
        )

    def _unused(self, rest: Rest, reason: str) -> Observation:
        boots, homings = self._references(rest.end)
        return Observation(
            rest.begin, rest.end, rest.q, boots=boots, homings=homings, used=False, reason=reason
        )

    def _needed_since(self) -> int:
        since = self._pending[0].begin if self._pending else self.rests.end
        if not self._observed:
            since = min(since, self.rests.begin)
        # The move before a rest is needed to align the clocks.
        return since - round((LONGEST_MOVE + 2.0 * self.alignment.search) * SECOND)
