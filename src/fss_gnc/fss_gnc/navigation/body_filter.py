"""Estimate the pose and twist of a body on the table from measured poses and turn rates.

    state  x, y, heading, their rates in the world, and the gyro's bias
    x' = v,  v' = a + noise of covariance G,  b' = noise

A Kalman filter with a full covariance (Bar-Shalom, Li, Kirubarajan, Estimation with Applications
to Tracking and Navigation, 2001, section 6.2.2). The known acceleration a and its noise come from
inputs.py. The filter keeps the measurements of the last MEMORY. When a measurement arrives late, or
an input is reported after it acted, the filter goes back to that time and repeats what followed.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from math import hypot, isfinite, pi
from typing import NamedTuple, Protocol

import numpy as np

from fss_arm_model.kernels import Floats, helper, kernel

from .settings import Bounds, SensorErrors

Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]

SECOND = 1_000_000_000
FORGOTTEN = 60 * SECOND  # longest gap between measurements; after it the old state is obsolete
FAR = 1e4  # largest plausible distance of a body from the world's origin [m]
MEMORY = 1_000_000_000  # length of the stored history [ns]
STRIDE = 20_000_000  # longest prediction step, in which the heading counts as constant [ns]
HELD_POSITION, HELD_HEADING = 0.003, 0.01  # of a held body's pose, by the arm, 1 sigma [m], [rad]
NONE = 0.0, 0.0, 0.0  # placeholder for events without a measurement
LEVER = 0.5  # speed change per change of turn rate that a kick may cause [m]
GATE = 5.0  # standard deviations beyond which a measurement is rejected
NIS_KEPT = 200  # number of stored NIS values of each kind of measurement
#: Kind of an event: time passes, a pose, a rate, the pose of a held body, a push.
NOTHING, POSE, RATE, HELD, PUSH = 0.0, 1.0, 2.0, 3.0, 4.0
#: Initial standard deviations: speed [m/s] along x and y, turn rate and gyro bias [rad/s].
AT_THE_BEGIN = 0.1, 0.1, 0.2, 0.01


@helper
def _step(  # type: ignore[no-untyped-def]
    x0, P0, acceleration, noise, row, gate, errors, x, P, out
):  # fmt: skip
    """Predict by dt, then update with a measurement that lies within the gate.

    If a measurement lies beyond the gate, the update is repeated under the assumption that the body
    was kicked since the last measurement.

    Args:
        x0: (7,) state.
        P0: (7, 7) covariance of the state.
        acceleration: (3,) known acceleration, in the body's axes.
        noise: (3, 3) density of its noise, in the body's axes.
        row: (5,) dt [s], the kind of event, the measurement.
        gate: largest squared normalized innovation.
        errors: (8,) density of the bias walk; variances of a rate, of a seen position and heading,
            of a held position and heading, of a kick in speed and in turn rate.
        x: (7,) state, written.
        P: (7, 7) covariance of the state, written.
        out: (3,) the squared normalized innovation, and 1 if the measurement was used; written.
    """
    dt, what, z = row[0], row[1], row[2:]
    place, heading = (errors[4], errors[5]) if what == HELD else (errors[2], errors[3])
    middle = x0[2] + 0.5 * dt * x0[5]
    c, s = np.cos(middle), np.sin(middle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    a, G = np.zeros(3), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            a[i] += R[i, j] * acceleration[j]
            for m in range(3):
                for n in range(3):
                    G[i, m] += R[i, j] * noise[j, n] * R[m, n]
    for i in range(7):
        x[i] = x0[i]
        for j in range(7):
            P[i, j] = P0[i, j]
    for i in range(3):
        x[i] += dt * (x0[3 + i] + 0.5 * dt * a[i])
        x[3 + i] += dt * a[i]
    for j in range(7):
        for i in range(3):
            P[i, j] += dt * P[3 + i, j]
    for i in range(7):
        for j in range(3):
            P[i, j] += dt * P[i, 3 + j]
    for i in range(3):
        for j in range(3):
            P[i, j] += G[i, j] * dt**3 / 3.0
            P[i, 3 + j] += G[i, j] * dt**2 / 2.0
            P[3 + i, j] += G[i, j] * dt**2 / 2.0
            P[3 + i, 3 + j] += G[i, j] * dt
    P[6, 6] += errors[0] * dt
    out[:] = 0.0
    if what == PUSH:
        for i in range(3):
            P[3 + i, 3 + i] += z[i]
    if what in (NOTHING, PUSH):
        return
    numbers = 1 if what == RATE else 3
    y, D, h = x.copy(), P.copy(), np.zeros(7)  # h: covariance of the state with the measurement
    for kicked in range(2):
        distance = 0.0
        for i in range(7):
            y[i] = x[i]
            for j in range(7):
                D[i, j] = P[i, j]
        if kicked:
            for i in range(3):
                line = LEVER**2 * errors[7] if what == RATE else errors[6]
                kick = errors[7] if i == 2 else line
                D[i, i] += kick * dt * dt
                D[i, 3 + i] += kick * dt
                D[3 + i, i] += kick * dt
                D[3 + i, 3 + i] += kick
        for number in range(numbers):
            last = 6 if what == RATE else number  # a gyro rate includes the bias
            first = 5 if what == RATE else number
            off = z[number]
            S = errors[1] if what == RATE else heading if number == 2 else place
            for i in range(first, last + 1):
                off -= y[i]
            if number == 2:
                off = (off + np.pi) % (2.0 * np.pi) - np.pi
            for i in range(7):
                h[i] = D[i, first] if first == last else D[i, first] + D[i, last]
            for i in range(first, last + 1):
                S += h[i]
            distance += off * off / S
            for i in range(7):
                y[i] += h[i] / S * off
                for j in range(7):
                    D[i, j] -= h[i] * h[j] / S
        if not kicked:
            out[0] = distance
        if distance <= gate:
            out[1] = 1.0
            for i in range(7):
                x[i] = y[i]
                for j in range(7):
                    P[i, j] = 0.5 * (D[i, j] + D[j, i])
            return


@kernel("(s),(s,s),(f,w),(f,w,w),(e,r),(),(c)->(e,s),(e,s,s),(e,w)")
def _steps(  # type: ignore[no-untyped-def]
    x0, P0, acceleration, noise, rows, gate, errors, x, P, out
):  # fmt: skip
    """Run one step for each row.

    Acceleration and noise have one entry for each row, or one for all rows.
    """
    for k in range(rows.shape[0]):
        of = min(k, acceleration.shape[0] - 1)
        known = acceleration[of], noise[of], rows[k], gate[0], errors
        if k:
            _step(x[k - 1], P[k - 1], *known, x[k], P[k], out[k])
        else:
            _step(x0, P0, *known, x[k], P[k], out[k])


class BodyState(NamedTuple):
    """Estimated state of a body at one time."""

    t: int  # [ns]
    pose: Floats  # (3,) x, y [m], unwrapped heading [rad]
    twist: Floats  # (3,) [m/s, m/s, rad/s], in the world
    covariance: Floats  # (6, 6) of pose and twist

    @property
    def pose_variance(self) -> Floats:
        """Variances of x, y [m^2] and heading [rad^2], (3,)."""
        return self.covariance.diagonal()[:3]

    @property
    def twist_variance(self) -> Floats:
        """Variances of the twist's components, (3,)."""
        return self.covariance.diagonal()[3:]

    def at(self, t: int) -> "BodyState":
        """Return the state at another time [ns], at constant twist; the covariance is unchanged."""
        return self._replace(t=t, pose=self.pose + (t - self.t) * 1e-9 * self.twist)


class Inputs(Protocol):
    """The known acceleration of a body."""

    def over(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return the mean acceleration in each interval between k + 1 times [ns].

        Returns:
            The accelerations in the body's axes, (k, 3) [m/s^2, m/s^2, rad/s^2], and the densities
            of their noise, (k, 3, 3); (1, 3) and (1, 3, 3) if they are the same in all intervals.
        """


class Free:
    """Inputs of a body without known acceleration, only noise.

    Args:
        errors: their accelerations are the noise.
    """

    def __init__(self, errors: SensorErrors) -> None:
        line, turn = errors.acceleration**2, errors.angular_acceleration**2
        self._known = np.zeros((1, 3)), np.diag([line, line, turn])[None]

    def over(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return zero acceleration and constant noise, the same for all intervals."""
        return self._known


class _Measured(NamedTuple):
    """A stored event: time [ns], kind and measurement."""

    t: int
    what: float
    z: Pose


class _Event(NamedTuple):
    """A stored event with the state and covariance after it."""

    measured: _Measured
    x: Floats
    P: Floats

    @property
    def t(self) -> int:
        return self.measured.t


class BodyFilter:
    """Kalman filter of one body; measurements may arrive in any order within MEMORY.

    A pose more than GATE standard deviations off is rejected and counted. If another body is at
    that pose, the rejection is counted under that body's name. Otherwise the filter restarts at the
    rejected poses once they have agreed with each other for the settle time.

    Args:
        errors: of the sensors, and the process noise.
        inputs: the known acceleration; none by default.
        elsewhere: function of a time [ns], a pose and a distance [m]. It returns the name of
            another body that is nearer to the pose than the distance, or an empty string.
        bounds: the state counts as unknown beyond them.
    """

    def __init__(
        self,
        errors: SensorErrors | None = None,
        inputs: Inputs | None = None,
        elsewhere: Callable[[int, Pose, float], str] | None = None,
        bounds: Bounds | None = None,
    ) -> None:
        self.errors = e = errors or SensorErrors()
        self.inputs, self.bounds = inputs or Free(e), bounds or Bounds()
        self.elsewhere = elsewhere or (lambda t, pose, within: "")
        self.rejected: Counter[str] = Counter()
        self.confused: tuple[int, str] | None = None  # time [ns] and other body of the last mix-up
        self.begun = 0  # number of starts
        self.events: deque[_Event] = deque()
        self.seen = self.turned = -1  # times of the last pose and of the last rate [ns]
        self.nis: dict[float, deque[float]] = {
            kind: deque(maxlen=NIS_KEPT) for kind in (POSE, RATE)
        }
        self._doubt: tuple[int, int, Pose] | None = None  # first and last time, last pose
        place = e.volume_error, e.volume_error, e.volume_heading_error, 0.0, 0.0, 0.0
        self._place = np.diag(np.square(place))
        deviations = (
            e.bias_walk, e.rate_error, e.position_error, e.heading_error, HELD_POSITION,
            HELD_HEADING, e.kick, e.angular_kick,
        )  # fmt: skip
        self._errors = np.square(deviations)

    @property
    def t(self) -> int:
        """Time of the estimate [ns]; -1 if there is none yet."""
        return self.events[-1].t if self.events else -1

    def pose(self, t: int, x: float, y: float, heading: float) -> bool:
        """Update with a pose [m, m, rad] seen at t [ns]; return True if it was accepted."""
        pose = x, y, heading
        if not hypot(x, y) < FAR:
            self.rejected["pose far away"] += 1
            return False
        if not self.events or t > self.t + FORGOTTEN:
            return self._begin(t, pose)
        if self.lost(t) and self._other(t, pose):  # the gate may be too wide
            return False
        if self._insert(t, POSE, pose):
            self.seen, self._doubt = max(self.seen, t), None
            return True
        return t > self.events[0].t and self._settle(t, pose)

    def rate(self, t: int, omega: float) -> bool:
        """Update with a gyro sample [rad/s] taken at t [ns]; return True if it was accepted."""
        if not isfinite(omega):
            self.rejected["gyro not finite"] += 1
            return False
        if not self.events or not self._insert(t, RATE, (omega, 0.0, 0.0)):
            return False
        self.turned = max(self.turned, t)
        return True

    def revise(self, t: int) -> None:
        """Recompute the estimates after t [ns], because known inputs since then have changed."""
        if self.events and (again := self._since(t)):
            self._apply(again)

    def predict(self, t: int) -> None:
        """Predict to t [ns] without a measurement."""
        while self.events and self.t < t:
            self._apply([_Measured(min(self.t + STRIDE, t), NOTHING, NONE)])

    def state(self) -> BodyState:
        """Return the newest estimate.

        Its covariance includes volume_error, which averaging does not reduce.

        Raises:
            IndexError: there is no estimate yet.
        """
        (t, _, _), x, P = self.events[-1]
        return BodyState(t, x[:3], x[3:6], P[:6, :6] + self._place)

    @property
    def bias(self) -> float:
        """Estimated bias of the gyro [rad/s]."""
        return float(self.events[-1].x[6])

    def push(self, t: int, speed: float, turn_rate: float) -> None:
        """Add the uncertainty of a push at t [ns], as standard deviations [m/s], [rad/s]."""
        if self.events:
            self._insert(t, PUSH, (speed**2, speed**2, turn_rate**2))

    def held(self, t: int, pose: Pose) -> bool:
        """Update with the pose of the held body at t [ns]; return as `pose`."""
        return self._insert(t, HELD, pose) if self.events else self._begin(t, pose)

    def distance(self, t: int, pose: Pose) -> float:
        """Return the Mahalanobis distance of a pose at t [ns] from the newest estimate."""
        last = self.events[-1]
        row = max(t - last.t, 0) * 1e-9, POSE, *pose
        _, _, out = self._stepped(last, [last.t, t], [row], -1.0)
        return float(out[0, 0] ** 0.5)

    def lost(self, t: int) -> str:
        """Return why the state at t [ns] counts as unknown; empty if it is known."""
        most = self.bounds
        if not self.events:
            return "not seen yet"
        if (silence := (t - self.seen) / SECOND) > most.max_outage:
            return f"not seen for {silence:.1f} s"
        P = self.events[-1].P
        for what, variance, bound, unit in (
            ("position", max(P[0, 0], P[1, 1]), most.max_position_deviation, "m"),
            ("heading", P[2, 2], most.max_heading_deviation, "rad"),
            ("speed", max(P[3, 3], P[4, 4]), most.max_speed_deviation, "m/s"),
        ):
            if not variance <= bound**2:
                return f"{what} known to {variance**0.5:.2g} {unit} only"
        return ""

    def _begin(self, t: int, pose: Pose) -> bool:
        """Start the filter at a pose; the number of full turns is kept."""
        e, turns = self.errors, 0.0
        if self.events:
            turns = 2.0 * pi * round((self.events[-1].x[2] - pose[2]) / (2.0 * pi))
        x = np.array([pose[0], pose[1], pose[2] + turns, 0.0, 0.0, 0.0, 0.0])
        deviations = e.position_error, e.position_error, e.heading_error, *AT_THE_BEGIN
        self.events.clear()
        self.events.append(_Event(_Measured(t, NOTHING, pose), x, np.diag(np.square(deviations))))
        self.begun, self.seen, self._doubt = self.begun + 1, t, None
        return True

    def _insert(self, t: int, what: float, z: Pose) -> bool:
        """Insert a measurement at its time and repeat the later ones.

        Returns:
            True if the measurement was used.
        """
        if not self.events[0].t < t <= self.t + FORGOTTEN:
            self.rejected["late"] += 1
            return False
        later = self._since(t) if t < self.t else ()
        square, taken = self._apply([_Measured(t, what, z), *later])
        if taken and what in self.nis:
            self.nis[what].append(square)
        elif not taken and what == RATE:
            self.rejected["gyro"] += 1
        return taken

    def _since(self, t: int) -> list[_Measured]:
        """Remove the estimates after t [ns]; return their measurements, which must be repeated."""
        later = []
        while len(self.events) > 1 and self.events[-1].t > t:
            later.append(self.events.pop().measured)
        return later[::-1]

    def _apply(self, measured: Sequence[_Measured]) -> tuple[float, bool]:
        """Process measurements in the order of time, from the newest estimate on.

        Returns:
            Squared normalized innovation of the first measurement, and whether that was used.
        """
        last = self.events[-1]
        times, rows, ends = [last.t], [], []
        for t, what, z in measured:
            while t - times[-1] > STRIDE:  # so that the heading is updated within a long prediction
                times.append(times[-1] + STRIDE)
                rows.append((STRIDE * 1e-9, NOTHING, *NONE))
            rows.append(((t - times[-1]) * 1e-9, what, *z))
            times.append(t)
            ends.append(len(rows) - 1)
        x, P, out = self._stepped(last, times, rows)
        self.events += [_Event(one, x[k], P[k]) for one, k in zip(measured, ends, strict=True)]
        while self.events[0].t < self.t - MEMORY and len(self.events) > 2:
            self.events.popleft()
        square, taken, _ = out[ends[0]].tolist()
        return square, taken > 0.0

    def _stepped(
        self, last: _Event, times: Sequence[int], rows: Sequence[Sequence[float]],
        gate: float = GATE**2,
    ) -> tuple[Floats, Floats, Floats]:  # fmt: skip
        found: tuple[Floats, Floats, Floats] = _steps(
            last.x, last.P, *self.inputs.over(times), rows, gate, self._errors
        )
        return found

    def _other(self, t: int, pose: Pose) -> bool:
        """Return True if another body is at the pose."""
        (then, _, _), x, _ = self.events[-1]
        ahead = (t - then) * 1e-9
        off = hypot(pose[0] - x[0] - ahead * x[3], pose[1] - x[1] - ahead * x[4])
        if name := self.elsewhere(t, pose, off):
            self.rejected[f"pose of the {name}"] += 1
            self.confused = t, name
        return bool(name)

    def _settle(self, t: int, pose: Pose) -> bool:
        """Restart if rejected poses have agreed for the settle time; return True if so."""
        if self._other(t, pose):
            self._doubt = None
            return False
        self.rejected["pose"] += 1
        e, since = self.errors, t
        if self._doubt:
            first, last, before = self._doubt
            moved = hypot(pose[0] - before[0], pose[1] - before[1])
            agrees = 0 <= t - last < SECOND // 5
            if agrees and moved < 10.0 * e.position_error + e.max_speed * (t - last) / SECOND:
                since = first
        self._doubt = since, t, pose
        return t - since >= e.settle_time * SECOND and self._begin(t, pose)
