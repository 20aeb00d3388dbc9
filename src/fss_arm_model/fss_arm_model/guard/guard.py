"""Guard against collisions of the arm with itself, its base, the target and the table's edge.

A path is checked continuously, not at samples (sweep.py). A stream of commands is checked as the
path that results if no other command follows: the command's motion, then the drives' braking.

A gap that starts below its margin must not shrink: until it reaches its margin, it may fall below
its largest value on the path by at most sweep.ALLOWED_DECREASE.
"""

from dataclasses import dataclass
from math import degrees, inf

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import body_name, gaps, links_and_base, sizes, with_edge, with_target
from fss_arm_model.description import Arm
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.guard.sweep import contacts, sweep

SELF, EDGE, TARGET = "self", "edge", "target"
MIN_KNOT_SPACING = 1e-6  # closer knots are merged [s]


@dataclass(frozen=True)
class Clear:
    """Result of a check without collisions; the pair closest to its margin is given."""

    guards: tuple[str, ...]  # what was checked: SELF, EDGE, TARGET
    bodies: tuple[str, ...]  # by name; () if there is no pair
    distance: float  # their least distance [m]; infinite without a pair
    time: float  # time of the least distance [s]


class GuardError(ValueError):
    """Two bodies would come closer to each other than their margin.

    Attributes:
        bodies: by name: "base", "link 3", "gripper", "target", "table edge".
        distance: least distance between them from this time on [m]; below 0 they collide.
        margin: required distance [m].
        time: time on the path from which the distance is too small [s].
        q: joint readings at the least distance (n) [rad].
        guards: what was checked.
    """

    def __init__(
        self,
        bodies: tuple[str, ...],
        distance: float,
        margin: float,
        time: float,
        q: tuple[float, ...],
        guards: tuple[str, ...],
    ) -> None:
        self.bodies, self.distance, self.margin = bodies, distance, margin
        self.time, self.q, self.guards = time, q, guards
        joints = ", ".join(f"{degrees(angle):.1f}" for angle in q)
        super().__init__(
            f"{bodies[0]} and {bodies[1]} would be {distance:.3f} m apart with the joints at "
            f"({joints}) deg, from {time:.2f} s on less than the {margin:.3f} m expected"
        )


class Guard:
    """Check, for one arm, that a motion keeps all bodies clear of each other and of the edge.

    In all methods base is the base's pose in the world (x, y [m], heading [rad]) and twist its
    velocity (vx, vy [m/s], omega [rad/s]) at the start; without a twist, base and arm together
    have no momentum. target is the pose of the object to grip, (3,), or pose and twist, (2, 3), in
    the world. Without base, only the arm against itself and the base is checked; each result
    lists what was checked.

    Raises, in all methods:
        GuardError: two bodies would come too near.
        ValueError: shapes do not fit, times do not ascend, or a number is not finite.
    """

    def __init__(self, arm: Arm, settings: GuardSettings | None = None) -> None:
        self.arm, self.settings = arm, settings or GuardSettings()
        s, n = self.settings, arm.n
        self._p, self._sizes = arm.vector(), sizes(s, s.target_radius, s.gripper_length)
        drives = [link.drive for link in arm.links]
        self._speeds = np.array([drive.max_velocity for drive in drives])
        self._gains = np.array([drive.max_acceleration for drive in drives])
        self._brakes = s.braking * self._gains
        rows = [(*pair, s.margin) for pair in links_and_base(n)]
        self._pairs: dict[tuple[str, ...], Floats] = {(SELF,): np.array(rows).reshape(-1, 3)}
        rows += [(*pair, s.edge_margin) for pair in with_edge(n)]
        self._pairs[SELF, EDGE] = np.array(rows)
        rows += [(*pair, s.margin) for pair in with_target(n)]
        rows[-1] = (*rows[-1][:2], -s.gripper_depth)  # margin of the gripper
        self._pairs[SELF, EDGE, TARGET] = np.array(rows)
        self.drift(np.zeros(3), np.zeros(3), np.zeros(n))  # loads the kernel

    def guards(
        self, base: npt.ArrayLike | None = None, target: npt.ArrayLike | None = None
    ) -> tuple[str, ...]:
        """Return what is checked if these are given."""
        if base is None:
            return (SELF,)
        return (SELF, EDGE) if target is None else (SELF, EDGE, TARGET)

    def slack(self, q: npt.ArrayLike) -> Floats:
        """Return the least gap of postures minus its margin, (...) for q (..., n) [m].

        The gaps are those of the arm against itself and its base. Below 0 a posture is rejected;
        without a pair the result is infinite.
        """
        q, pairs = np.asarray(q, dtype=float), self._pairs[SELF,]
        state = np.concatenate([np.zeros((*q.shape[:-1], 3)), q], axis=-1)
        found = gaps(self._p, state, pairs[:, :2], self._sizes)
        return np.min(found - pairs[:, 2], axis=-1, initial=inf)

    def check_posture(
        self,
        q: npt.ArrayLike,
        base: npt.ArrayLike | None = None,
        target: npt.ArrayLike | None = None,
    ) -> Clear:
        """Check that a posture (n) [rad] keeps all margins."""
        guards = self.guards(base, target)
        pairs, q = self._pairs[guards], self._checked_array("q", q)
        pose = self._checked_array("base", (0.0, 0.0, 0.0) if base is None else base, 3)
        at = self._target(guards, target)[:2]
        found = gaps(self._p, np.concatenate([pose, q]), pairs[:, :2], self._sizes, at)
        if not len(pairs):
            return Clear(guards, (), inf, 0.0)
        least = int(np.argmin(found - pairs[:, 2]))
        if found[least] < pairs[least, 2]:
            raise self._error(guards, pairs[least], float(found[least]), 0.0, q)
        return Clear(guards, self._body_names(pairs[least]), float(found[least]), 0.0)

    def check_path(
        self,
        times: npt.ArrayLike,
        q: npt.ArrayLike,
        qd: npt.ArrayLike,
        base: npt.ArrayLike | None = None,
        twist: npt.ArrayLike | None = None,
        target: npt.ArrayLike | None = None,
    ) -> Clear:
        """Check that a path keeps all margins; it is cubic between its knots, as in the links.

        Args:
            times: (k,) two or more knots, ascending [s]; base, twist and target are those at the
                first.
            q: (k, n) readings at these times [rad].
            qd: (k, n) rates at these times [rad/s].
            base: pose, see the class.
            twist: see the class.
            target: see the class.
        """
        times = np.asarray(times, dtype=float)
        if times.ndim != 1 or times.size < 2 or not (np.diff(times) > 0.0).all():
            raise ValueError(f"times are {times} s, expected two or more, ascending")
        shape = (times.size, self.arm.n)
        q, qd = self._checked_array("q", q, *shape), self._checked_array("qd", qd, *shape)
        guards = self.guards(base, target)
        state = np.full(6, np.nan)
        if base is not None:
            state[:3] = self._checked_array("base", base, 3)
            state[3:] = np.nan if twist is None else self._checked_array("twist", twist, 3)
        pairs, goal = self._pairs[guards], self._target(guards, target)
        contact, time, distance, which, where = sweep(
            self._p, state, times, q, qd, pairs, self._sizes, goal
        )
        if contact:
            raise self._error(guards, pairs[which], distance, time, where)
        if which < 0:
            return Clear(guards, (), inf, time)
        return Clear(guards, self._body_names(pairs[which]), distance, time)

    def clear(
        self, times: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike, base: npt.ArrayLike
    ) -> npt.NDArray[np.bool_]:
        """Return True for each of many paths that check_path would accept, (...).

        Args:
            times: (..., k) times of knots, ascending [s]; the system has no momentum.
            q: (..., k, n) readings at these times [rad].
            qd: (..., k, n) rates at these times [rad/s].
            base: pose at the first time.
        """
        times = np.asarray(times, dtype=float)
        if times.shape[-1] < 2 or not (np.diff(times) > 0.0).all():
            raise ValueError(f"times are {times} s, expected two or more, ascending")
        shape, pairs = (*times.shape, self.arm.n), self._pairs[self.guards(base)]
        q, qd = self._checked_array("q", q, *shape), self._checked_array("qd", qd, *shape)
        state = [*self._checked_array("base", base, 3), np.nan, np.nan, np.nan]
        return ~contacts(self._p, state, times, q, qd, pairs, self._sizes, np.zeros(4))

    def check_command(
        self,
        q: npt.ArrayLike,
        qd: npt.ArrayLike,
        horizon: float = 0.0,
        *,
        velocity: npt.ArrayLike | None = None,
        position: npt.ArrayLike | None = None,
        max_velocity: npt.ArrayLike | None = None,
        max_acceleration: npt.ArrayLike | None = None,
        until: float = inf,
        base: npt.ArrayLike | None = None,
        twist: npt.ArrayLike | None = None,
        target: npt.ArrayLike | None = None,
    ) -> Clear:
        """Check that the arm keeps clear if it follows a command, and then comes to rest.

        A joint with a `position` moves there by its own trapezoid, and rests. Any other joint turns
        at its `velocity` for the horizon and then brakes, at GuardSettings.braking of the
        acceleration. For a torque command, give the largest velocity that it may cause, in the
        direction of the torque. NaN: not commanded.

        Args:
            q: (n) current readings [rad].
            qd: (n) current rates [rad/s].
            horizon: how long the command acts if no other follows [s].
            velocity: (n) commanded [rad/s]; for joints without it the current rate.
            position: (n) commanded [rad].
            max_velocity: (n) of the trapezoids [rad/s]; the drives' limits by default.
            max_acceleration: (n) to accelerate and brake with [rad/s^2]; the same default.
            until: time at which the motion is cut off in any case [s].
            base: pose, see the class.
            twist: see the class.
            target: see the class.
        """
        q, qd = self._checked_array("q", q), self._checked_array("qd", qd)
        a = self._checked_array("max_acceleration", self._or_default(max_acceleration, self._gains))
        if not (a > 0.0).all():
            raise ValueError(f"max_acceleration is {a.tolist()} rad/s^2, expected more than 0")
        none = np.full(self.arm.n, np.nan)
        wanted = np.asarray(self._or_default(velocity, none), dtype=float)
        wanted = self._checked_array("velocity", np.where(np.isnan(wanted), qd, wanted))
        goal = np.asarray(self._or_default(position, none), dtype=float)
        way = self._checked_array("position", np.where(np.isnan(goal), q, goal)) - q
        top = self._checked_array("max_velocity", self._or_default(max_velocity, self._speeds))
        turned = turning(qd, wanted, a, self.settings.braking * a, horizon)
        gone = trapezoids(way, qd, top, a)
        lasts, gains = (np.where(np.isnan(goal), *both) for both in zip(turned, gone, strict=True))
        path = moved(q, qd, (lasts, gains), horizon, until)
        return self.check_path(*path, base, twist, target)

    def drift(
        self,
        base: npt.ArrayLike,
        twist: npt.ArrayLike,
        q: npt.ArrayLike,
        qd: npt.ArrayLike | None = None,
        longest: float = 60.0,
    ) -> float:
        """Return the time until the drifting base brings a body to the edge's margin [s].

        The arm brakes from qd (n), at rest by default, and then holds its posture. The result is
        infinite above `longest` [s], and 0 if a body is within the margin and comes nearer.
        """
        q = self._checked_array("q", q)
        qd = self._checked_array("qd", self._or_default(qd, np.zeros(self.arm.n)))
        times, q, qd = moved(q, qd, turning(qd, qd, self._brakes, self._brakes, 0.0), longest)
        state = [*self._checked_array("base", base, 3), *self._checked_array("twist", twist, 3)]
        pairs = self._pairs[SELF, EDGE][len(self._pairs[SELF,]) :]
        contact, time, *_ = sweep(self._p, state, times, q, qd, pairs, self._sizes, np.zeros(4))
        return time if contact else inf

    def braking(self, qd: npt.ArrayLike) -> float:
        """Return the longest time that the drives need to stop from rates (n) [s]."""
        return float((np.abs(self._checked_array("qd", qd)) / self._brakes).max())

    def _checked_array(self, name: str, given: npt.ArrayLike, *shape: int) -> Floats:
        """Return a finite array, (n) by default; raise ValueError if it has another shape."""
        array = np.asarray(given, dtype=float)
        shape = shape or (self.arm.n,)
        if array.shape != shape:
            raise ValueError(f"{name} has the shape {array.shape}, expected {shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} is {array.tolist()}, expected finite numbers")
        return array

    @staticmethod
    def _or_default(given: npt.ArrayLike | None, default: Floats) -> npt.ArrayLike:
        return default if given is None else given

    def _target(self, guards: tuple[str, ...], target: npt.ArrayLike | None) -> Floats:
        """Return position and velocity of the target, (4,): x, y [m], vx, vy [m/s]."""
        if TARGET not in guards or target is None:
            return np.zeros(4)
        rows = np.asarray(target, dtype=float).reshape(-1, 3)
        rows = np.concatenate([rows, np.zeros((2, 3))])[:2] if len(rows) == 1 else rows
        return self._checked_array("target", rows, 2, 3)[:, :2].ravel()

    def _body_names(self, pair: Floats) -> tuple[str, ...]:
        return tuple(body_name(int(body), self.arm.n) for body in pair[1::-1])

    def _error(
        self, guards: tuple[str, ...], pair: Floats, distance: float, time: float, q: Floats
    ) -> GuardError:
        return GuardError(
            self._body_names(pair), distance, float(pair[2]), time, tuple(q.tolist()), guards
        )


Phases = tuple[Floats, Floats]  # durations [s] and accelerations [rad/s^2], (phases, n) each


def turning(qd: Floats, wanted: Floats, a: Floats, brake: Floats, horizon: float) -> Phases:
    """Return phases from rates (n) to others at a (n), held until the horizon, then braking."""
    change = np.minimum(np.abs(wanted - qd) / a, horizon)
    speeding = np.sign(wanted - qd) * a
    reached = qd + speeding * change
    still = np.zeros_like(qd)
    times = np.stack([change, horizon - change, np.abs(reached) / brake])
    return times, np.stack([speeding, still, -np.sign(reached) * brake])


def trapezoids(way: Floats, qd: Floats, top: Floats, a: Floats) -> Phases:
    """Return phases of a motion by `way` (n) from rates (n), each joint in its least time.

    A joint that cannot stop in time comes back.
    """
    out = np.sign(way - 0.5 * qd * np.abs(qd) / a)  # 0: braking alone reaches the goal
    out = np.where(out == 0.0, np.sign(qd), out)
    speed = np.minimum(top, np.sqrt(np.maximum(a * out * way + 0.5 * qd**2, 0.0)))
    change, back = out * speed - qd, -out * a
    speeding = np.sign(change) * a
    begin = np.abs(change) / a
    end = speed / a
    rest = out * way - 0.5 * (out * qd + speed) * begin - 0.5 * speed * end
    held = np.where(speed > 0.0, np.maximum(rest, 0.0) / np.where(speed > 0.0, speed, 1.0), 0.0)
    return np.stack([begin, held, end]), np.stack([speeding, np.zeros_like(qd), back])


def moved(
    q: Floats, qd: Floats, phases: Phases, least: float, most: float = inf
) -> tuple[Floats, Floats, Floats]:
    """Return knots of joints that pass through phases, each with its own times, and then rest.

    Returns:
        times (k,) from 0, for `least` to `most` seconds, readings and rates (k, n).
    """
    lasts, a = phases
    ends = np.cumsum(lasts, axis=0)
    times = np.minimum(np.sort(np.append(ends, max(least, MIN_KNOT_SPACING))), most)
    times = np.concatenate([[0.0], times[np.diff(times, prepend=0.0) > MIN_KNOT_SPACING]])
    if times.size == 1:
        times = np.array([0.0, 2.0 * MIN_KNOT_SPACING])
    spent = np.clip(times[:, None, None] - (ends - lasts), 0.0, lasts)  # (k, phases, n)
    gained = a * spent
    begin = qd + np.cumsum(a * lasts, axis=0) - a * lasts  # rates at the starts of phases
    return (
        times,
        q + np.sum(spent * (begin + 0.5 * gained), axis=1),
        qd + gained.sum(axis=1),
    )
