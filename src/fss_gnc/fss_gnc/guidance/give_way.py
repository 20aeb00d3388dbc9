"""Giving way: changes of a base's path that keep clear of other vehicles.

A base that moves slows down along its path, waits, and continues. A base at rest starts later; to a
pose it may also move through a point beside the straight line. The first arrival is chosen that is
clear of all predicted motions. If there is none, the base rests, and tries again and again. It then
moves aside if another vehicle comes to its place.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from fss_arm_model.arrays import Complexes, Floats
from fss_gnc.guidance.activity import ActivityError, Craft, Observation
from fss_gnc.guidance.free_space import FreeSpace
from fss_gnc.guidance.limits import MIN_DURATION, limit_use
from fss_gnc.guidance.other_vehicles import (
    MONITORED_SHARE,
    REACTION_TIME,
    Conflict,
    OtherVehicle,
    facing_announced_plan,
    gives_way,
    path_conflicts,
)
from fss_gnc.reference import Path, Reference, pose_error

WAITS = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)  # [s]
DETOUR_SHARES = (0.25, 0.5, 0.75)  # of the way, at which a detour is farthest from it
DETOUR_OFFSETS = (0.4, 0.7, 1.0, 1.3, 1.6)  # of a detour, to both sides [m]
REFUGE_DISTANCES = (0.2, 0.4, 0.6, 0.8, 1.0, 1.3)  # to places to make room at [m]
REFUGE_DIRECTIONS = 8
CANDIDATES_PER_STEP = 16  # paths checked per step, which must be quick
RETRY_PERIOD = 1.0  # from the end of a search to the next one [s]
WAIT_PLAN = 4.0  # time for which a wait is announced at a time [s]
KNOT_SPACING = 1.0  # of a path with a pause [s]
MAX_RAMP = 120.0  # longest time to come to rest along a path [s]


class GiveWay:
    """Changes of the path of one motion.

    Args:
        craft: base and arm.
        free_space: of edge and target.
        path: as requested.
        may_detour: True if only the end of the path matters, as in base/go_to.
    """

    def __init__(self, craft: Craft, free_space: FreeSpace, path: Path, may_detour: bool) -> None:
        self.settings, self.free_space, self.may_detour = craft.settings, free_space, may_detour
        self.waits_for = ""  # vehicle for which it rests, or moves aside; empty: none
        self.reason = ""  # why it does not follow the path as requested; empty: it does
        self._goal = path.knots[-1, 0]
        self._was_checked = False  # True once the requested path was checked
        # The requested duration as a multiple of the shortest one.
        self._slowness = max(1.0, path.end_time / self._shortest(path.knots[0, 0], self._goal))
        self._rest = path, 0.0  # path, and time on it, at which the base rests
        self._direct = path  # to the goal from rest, from time 0
        self._departures: list[tuple[float, Path]] = []  # waits, and paths from time 0
        self._next, self._retry_time = 0, -np.inf  # candidate of the search; start of the next [s]

    def plan(self, path: Path, t: float) -> Path:
        """Return the plan to announce during a wait: the path, and then a rest that may end."""
        steps = t + _even_steps(max(path.end_time - t, 0.0))
        times = np.append(steps, steps[-1] + WAIT_PLAN)
        return Path(times, path.states(times)[:, :1])

    def update(self, path: Path, obs: Observation) -> Path:
        """Return the path of the base from now on.

        Raises:
            ActivityError: base or joints are not known.
        """
        if not obs.others:
            return path
        own, reference = self.free_space.outline(obs), path.at(obs.t)
        is_moving = not self._is_at_rest(reference)
        if self.waits_for:
            return path if obs.t < path.end_time else self._depart(path, obs, own)
        stopping_time = self._min_ramp(reference) + REACTION_TIME
        if self._was_checked:
            others, share = facing_announced_plan(obs.others), MONITORED_SHARE
        else:
            others, share = obs.others, 1.0
        self._was_checked = True
        conflict = self._conflict(own, path, obs.t, others, stopping_time, share)
        if conflict is None:
            return path
        self.reason = f"gives way to {conflict.vehicle.name}"
        if is_moving:
            ramp = self._ramp(path, obs.t)
            for wait in WAITS:
                paused = pause(path, obs.t, ramp, wait)
                if self._is_clear(own, paused, obs):
                    return paused
            self._rest = path, obs.t + 0.5 * ramp
            path = pause(path, obs.t, ramp, np.inf)
        else:
            self._rest = path, obs.t
            path = rest(reference, obs.t)
        self._wait_for(conflict)
        return path

    def _wait_for(self, conflict: Conflict) -> None:
        self.waits_for = conflict.vehicle.name
        self.reason = f"waits for {self.waits_for}"
        self._departures, self._retry_time = [], -np.inf

    def _depart(self, path: Path, obs: Observation, own: Complexes) -> Path:
        """Return the first clear path to the goal, or aside; a few are checked per step."""
        if obs.t < self._retry_time:
            return path
        if not self._departures:
            self._departures, self._next = self._all_departures(path.at(obs.t)), 0
        for wait, departure in self._departures[self._next : self._next + CANDIDATES_PER_STEP]:
            candidate = shifted(departure, obs.t + wait)
            if self._is_clear(own, candidate, obs):
                return self._leave(candidate)
        self._next += CANDIDATES_PER_STEP
        if self._next < len(self._departures):
            return path
        self._next, self._retry_time = 0, obs.t + RETRY_PERIOD
        return self._insist_or_move_aside(path, obs, own)

    def _leave(self, path: Path) -> Path:
        self.reason, self.waits_for, self._departures = f"gives way to {self.waits_for}", "", []
        return path

    def _insist_or_move_aside(self, path: Path, obs: Observation, own: Complexes) -> Path:
        """Return a path to the goal if all vehicles in its way must make room, or a path aside."""
        direct = shifted(self._direct, obs.t)
        stopping_time = self._ramp(direct, direct.times.mean())
        conflict = self._conflict(own, direct, obs.t, obs.others, stopping_time)
        if conflict is None and self._is_free(direct, obs):
            return self._leave(direct)
        if conflict is not None:
            self.waits_for = conflict.vehicle.name
            self.reason = f"waits for {self.waits_for}"
        if self._conflict(own, path, obs.t, facing_announced_plan(obs.others), np.inf) is None:
            return path
        here = path.at(obs.t)
        for place in self._refuges(here.pose):
            aside = shifted(self._between(here, place, 1.0), obs.t)
            if self._is_clear(own, aside, obs):
                self._departures = []
                return aside
        return path

    def _conflict(
        self,
        own: Complexes,
        path: Path,
        t: float,
        others: Sequence[OtherVehicle],
        stopping_time: float,
        share: float = 1.0,
    ) -> Conflict | None:
        """Return the first conflict of a path from its time t on that this vehicle must resolve.

        `share` is the required part of the gap.
        """
        margin = share * self.settings.vehicle_gap
        found = path_conflicts(own, path, t, others, margin)
        return next((one for one in found if gives_way(one, stopping_time)), None)

    def _is_clear(self, own: Complexes, path: Path, obs: Observation) -> bool:
        """Return True if a path is clear of all vehicles, of the edge and of the target."""
        margin = self.settings.vehicle_gap
        is_clear = not path_conflicts(own, path, obs.t, obs.others, margin)
        return is_clear and self._is_free(path, obs)

    def _is_free(self, path: Path, obs: Observation) -> bool:
        try:
            self.free_space.check(path, obs.t, obs)
        except ActivityError:
            return False
        return True

    def _is_at_rest(self, reference: Reference) -> bool:
        speed = float(np.hypot(*reference.twist[:2]))
        turn_rate = abs(float(reference.twist[2]))
        return speed <= self.settings.rest_speed and turn_rate <= self.settings.rest_turn_rate

    def _min_ramp(self, reference: Reference) -> float:
        s, speed = self.settings, float(np.hypot(*reference.twist[:2]))
        turn_rate = abs(float(reference.twist[2]))
        return max(MIN_DURATION, speed / s.acceleration, turn_rate / s.turn_acceleration)

    def _ramp(self, path: Path, t: float) -> float:
        """Return the time in which the base comes to rest along a path within the limits [s]."""
        reference = path.at(t)
        ramp = self._min_ramp(reference)
        while ramp < MAX_RAMP:
            stop = pause(path, t, ramp, np.inf)
            if limit_use(self.settings, stop, reference.twist).share <= 1.05:
                break
            ramp *= 1.3
        return ramp

    def _all_departures(self, here: Reference) -> list[tuple[float, Path]]:
        """Return waits, and paths to the goal from rest at time 0, in the order of arrival."""
        if self.may_detour:
            goal = here.pose + pose_error(self._goal, here.pose)
            paths = [self._between(here, goal, self._slowness)]
            paths += [self._through(here.pose, via, goal) for via in self._detours(here.pose, goal)]
        else:
            path, t = self._rest
            onward = resumed(path, t, 0.0, self._ramp(path, min(t + 20.0, path.end_time)))
            paths = [self._returned(here, onward)]
        self._direct = paths[0]
        return sorted(product(WAITS, paths), key=lambda one: one[0] + one[1].end_time)

    def _shortest(self, start: Floats, goal: Floats) -> float:
        """Return the shortest duration from rest to rest [s]."""
        s, way = self.settings, np.abs(pose_error(goal, start))
        distance, turn = float(np.hypot(*way[:2])), float(way[2])
        # Peaks of the quintic from rest to rest: 15/8 of the mean speed, and 10/sqrt(3) d/T^2.
        speed = 1.875 * max(distance / s.speed, turn / s.turn_rate)
        acceleration = max(distance / s.acceleration, turn / s.turn_acceleration)
        return max(MIN_DURATION, speed, float(np.sqrt(10.0 / np.sqrt(3.0) * acceleration)))

    def _between(self, start: Reference, goal: Floats, slowness: float) -> Path:
        at_rest = Reference.at_rest(start.pose)
        duration = slowness * self._shortest(start.pose, goal)
        return Path.between(at_rest, start.pose + pose_error(goal, start.pose), 0.0, duration)

    @staticmethod
    def _detours(start: Floats, goal: Floats) -> list[Floats]:
        """Return poses beside the straight line, (3,) each."""
        way = goal - start
        distance = float(np.hypot(*way[:2]))
        along = complex(*way[:2]) / distance if distance > 0.1 else 1.0
        found = []
        for share, offset, side in product(DETOUR_SHARES, DETOUR_OFFSETS, (1j, -1j)):
            aside = side * offset * along
            found.append(start + share * way + np.array([aside.real, aside.imag, 0.0]))
        return found

    def _returned(self, here: Reference, path: Path) -> Path:
        """Return a path from rest at time 0 that leads back to the start of another one first."""
        start = path.knots[0, 0]
        if np.allclose(here.pose, start, rtol=0.0, atol=1e-3):
            return path
        back = self._between(here, start, 1.0)
        times = _even_steps(back.end_time)
        knots = np.concatenate([back.states(times)[:, :2], path.knots[1:]])
        return Path(np.concatenate([times, back.end_time + path.times[1:]]), knots)

    def _through(self, start: Floats, via: Floats, goal: Floats) -> Path:
        """Return a smooth path from rest through a pose to rest, from time 0."""
        from scipy.interpolate import CubicSpline

        poses = np.array([start, via, goal])
        lengths = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        times = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 0.05))])
        times *= 1.5 / self.settings.speed  # peak by mean speed of a cubic
        while True:
            twists = CubicSpline(times, poses, bc_type="clamped")(times, 1)
            path = Path(times, np.stack([poses, twists], axis=1))
            if (share := limit_use(self.settings, path).share) <= 1.0:
                break
            times = times * max(np.sqrt(share), 1.02)
        slow = np.array([[[1.0], [1.0 / self._slowness]]])
        return Path(self._slowness * times, slow * path.knots)

    @staticmethod
    def _refuges(pose: Floats) -> list[Floats]:
        """Return poses around a pose, the nearest first, (3,) each."""
        directions = np.exp(2j * np.pi * np.arange(REFUGE_DIRECTIONS) / REFUGE_DIRECTIONS)
        offsets = np.outer(REFUGE_DISTANCES, directions).ravel()
        return list(pose + np.column_stack([offsets.real, offsets.imag, np.zeros(offsets.size)]))


def rest(reference: Reference, t: float) -> Path:
    """Return a path that stays at the pose of a reference from the time t on [s]."""
    return Path(np.array([t]), reference.pose.reshape(1, 1, 3))


def shifted(path: Path, delay: float) -> Path:
    """Return a path that is later by a delay [s]; it rests before its start."""
    return Path(path.times + delay, path.knots)


def pause(path: Path, t: float, ramp: float, wait: float) -> Path:
    """Return a path that comes to rest along the given one, waits, and continues.

    Args:
        path: as planned.
        t: present time on it [s].
        ramp: time to come to rest, and to come back to speed [s].
        wait: time at rest [s]; inf: it stays at rest.
    """
    s = _even_steps(ramp)
    stop = _retimed(path, t + s, t + s - 0.5 * s**2 / ramp, 1.0 - s / ramp)
    if np.isinf(wait):
        return stop
    rest_of_it = resumed(path, t + 0.5 * ramp, t + ramp + wait, ramp)
    first = 1 if wait == 0.0 else 0
    times = np.concatenate([stop.times, rest_of_it.times[first:]])
    return Path(times, np.concatenate([stop.knots, rest_of_it.knots[first:]]))


def resumed(path: Path, t: float, start: float, ramp: float) -> Path:
    """Return the rest of a path from its time t on [s], from rest at the time `start` [s].

    The base comes to speed within `ramp` [s].
    """
    s = _even_steps(ramp)
    rest_of_it = _even_steps(max(path.end_time - t - 0.5 * ramp, 0.0))[1:]
    phases = np.concatenate([0.5 * s**2 / ramp, 0.5 * ramp + rest_of_it])
    rates = np.concatenate([s / ramp, np.ones(rest_of_it.size)])
    return _retimed(path, start + np.concatenate([s, ramp + rest_of_it]), t + phases, rates)


def _even_steps(duration: float) -> Floats:
    return np.linspace(0.0, duration, int(np.ceil(duration / KNOT_SPACING)) + 1)


def _retimed(path: Path, times: Floats, phases: Floats, rates: Floats) -> Path:
    """Return the path that is at the phases of another one at given times, (k,) each [s]."""
    states = path.states(phases)
    return Path(times, np.stack([states[:, 0], rates[:, None] * states[:, 1]], axis=1))
