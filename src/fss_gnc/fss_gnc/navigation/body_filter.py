"""Estimate the pose and twist of a body on the table from measured poses and turn rates.

    state  x, y, heading, their rates in the world, and the gyro's bias
    x' = v,  v' = a + noise of covariance G,  b' = noise

A Kalman filter with a full covariance (Bar-Shalom, Li, Kirubarajan, Estimation with Applications
to Tracking and Navigation, 2001, section 6.2.2). The known acceleration a and its noise come from
inputs.py. The filter keeps the measurements of the last HISTORY_LENGTH. When a measurement arrives
late, or an input is reported after it acted, the filter goes back to that time and repeats what
followed.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from math import hypot, isfinite, pi
from typing import NamedTuple, Protocol

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.units import SECOND

from .settings import Bounds, SensorErrors

Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]

MAX_GAP = 60 * SECOND  # longest gap between measurements; after it the old state is obsolete
MAX_WORLD_DISTANCE = 1e4  # largest plausible distance of a body from the world's origin [m]
HISTORY_LENGTH = 1_000_000_000  # length of the stored history [ns]
MAX_STEP = 20_000_000  # longest prediction step, in which the heading counts as constant [ns]
HELD_POSITION_ERROR, HELD_HEADING_ERROR = 0.003, 0.01  # 1 sigma of the arm's pose [m], [rad]
NO_MEASUREMENT = 0.0, 0.0, 0.0  # placeholder for events without a measurement
KICK_LEVER = 0.5  # speed change per change of turn rate that a kick may cause [m]
GATE_SIGMA = 5.0  # standard deviations beyond which a measurement is rejected
MAX_SPEED = 0.5  # speed up to which rejected poses count as those of one body [m/s]
MAX_NIS_VALUES = 200  # number of stored NIS values of each kind of measurement
#: Kind of an event: time passes, a pose, a rate, the pose of a held body, a push.
TIME_ONLY, POSE, RATE, HELD_POSE, PUSH = 0.0, 1.0, 2.0, 3.0, 4.0
#: Initial standard deviations: speed [m/s] along x and y, turn rate and gyro bias [rad/s].
INITIAL_SIGMA = 0.1, 0.1, 0.2, 0.01


class Variances(NamedTuple):
    """Noise of the filter's model and measurements."""

    bias_walk: float  # density
    rate: float
    position: float
    heading: float
    held_position: float
    held_heading: float
    kick: float  # in speed
    angular_kick: float


@helper
def _step(  # type: ignore[no-untyped-def]
    x0, P0, acceleration, noise, row, gate, variances, x, P, out
):
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
        variances: of noise and measurements.
        x: (7,) state, written.
        P: (7, 7) covariance of the state, written.
        out: (3,) the squared normalized innovation, and 1 if the measurement was used; written.
    """
    dt, kind, z = row[0], row[1], row[2:]
    position_variance, heading_variance = variances.position, variances.heading
    if kind == HELD_POSE:
        position_variance, heading_variance = variances.held_position, variances.held_heading
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
    P[6, 6] += variances.bias_walk * dt
    out[:] = 0.0
    if kind == PUSH:
        for i in range(3):
            P[3 + i, 3 + i] += z[i]
    if kind in (TIME_ONLY, PUSH):
        return
    numbers = 1 if kind == RATE else 3
    y, D, h = x.copy(), P.copy(), np.zeros(7)  # h: covariance of the state with the measurement
    for kicked in range(2):
        distance = 0.0
        for i in range(7):
            y[i] = x[i]
            for j in range(7):
                D[i, j] = P[i, j]
        if kicked:
            for i in range(3):
                kick = variances.angular_kick
                if i < 2:
                    kick = KICK_LEVER**2 * kick if kind == RATE else variances.kick
                D[i, i] += kick * dt * dt
                D[i, 3 + i] += kick * dt
                D[3 + i, i] += kick * dt
                D[3 + i, 3 + i] += kick
        for number in range(numbers):
            last = 6 if kind == RATE else number  # a gyro rate includes the bias
            first = 5 if kind == RATE else number
            off = z[number]
            S = heading_variance if number == 2 else position_variance
            if kind == RATE:
                S = variances.rate
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
    x0, P0, acceleration, noise, rows, gate, v, x, P, out
):
    """Run one step for each row.

    Acceleration and noise have one entry for each row, or one for all rows.
    """
    variances = Variances(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7])
    for k in range(rows.shape[0]):
        of = min(k, acceleration.shape[0] - 1)
        known = acceleration[of], noise[of], rows[k], gate[0], variances
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

    def extrapolate_to(self, t: int) -> "BodyState":
        """Return the state at another time [ns], at constant twist; the covariance is unchanged."""
        return self._replace(t=t, pose=self.pose + (t - self.t) * 1e-9 * self.twist)


class Inputs(Protocol):
    """The known acceleration of a body."""

    def mean_accelerations(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return the mean acceleration in each interval between k + 1 times [ns].

        Returns:
            The accelerations in the body's axes, (k, 3) [m/s^2, m/s^2, rad/s^2], and the densities
            of their noise, (k, 3, 3); (1, 3) and (1, 3, 3) if they are the same in all intervals.
        """


class NoInputs:
    """Inputs of a body without known acceleration, only noise.

    Args:
        errors: the accelerations are the noise.
    """

    def __init__(self, errors: SensorErrors) -> None:
        speed_variance, turn = errors.acceleration**2, errors.angular_acceleration**2
        self._known = np.zeros((1, 3)), np.diag([speed_variance, speed_variance, turn])[None]

    def mean_accelerations(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return zero acceleration and constant noise, the same for all intervals."""
        return self._known


class _Measurement(NamedTuple):
    """A stored event: time [ns], kind and measurement."""

    t: int
    kind: float
    z: Pose


class _Event(NamedTuple):
    """A stored event with the state and covariance after it."""

    measurement: _Measurement
    x: Floats
    P: Floats

    @property
    def t(self) -> int:
        return self.measurement.t


class BodyFilter:
    """Kalman filter of one body; measurements may arrive in any order within HISTORY_LENGTH.

    A pose more than GATE_SIGMA standard deviations off is rejected and counted. If another body is
    at that pose, the rejection is counted under that body's name. Otherwise the filter restarts at
    the rejected poses once they have agreed with each other for the settle time.

    Args:
        errors: of the sensors, and the process noise.
        inputs: the known acceleration; none by default.
        other_body_at: function of a time [ns], a pose and a distance [m]. It returns the name of
            another body that is nearer to the pose than the distance, or an empty string.
        bounds: the state counts as unknown beyond them.
    """

    def __init__(
        self,
        errors: SensorErrors | None = None,
        inputs: Inputs | None = None,
        other_body_at: Callable[[int, Pose, float], str] | None = None,
        bounds: Bounds | None = None,
    ) -> None:
        self.errors = e = errors or SensorErrors()
        self.inputs, self.bounds = inputs or NoInputs(e), bounds or Bounds()
        self.other_body_at = other_body_at or (lambda t, pose, within: "")
        self.rejected: Counter[str] = Counter()
        self.last_mixup: tuple[int, str] | None = (
            None  # time [ns] and other body of the last mix-up
        )
        self.start_count = 0
        self.events: deque[_Event] = deque()
        self.last_pose_time = self.last_rate_time = -1  # [ns]; -1: none
        self.nis: dict[float, deque[float]] = {
            kind: deque(maxlen=MAX_NIS_VALUES) for kind in (POSE, RATE)
        }
        self._candidate: tuple[int, int, Pose] | None = None  # first and last time, last pose
        volume_sigma = e.volume_error, e.volume_error, e.volume_heading_error, 0.0, 0.0, 0.0
        self._volume_covariance = np.diag(np.square(volume_sigma))
        deviations = (
            e.bias_walk,
            e.rate_error,
            e.position_error,
            e.heading_error,
            HELD_POSITION_ERROR,
            HELD_HEADING_ERROR,
            e.kick,
            e.angular_kick,
        )
        self._variances = Variances(*np.square(deviations).tolist())

    @property
    def t(self) -> int:
        """Time of the estimate [ns]; -1 if there is none yet."""
        return self.events[-1].t if self.events else -1

    def update_pose(self, t: int, x: float, y: float, heading: float) -> bool:
        """Update with a pose [m, m, rad] measured at t [ns]; return True if it was accepted."""
        pose = x, y, heading
        if not hypot(x, y) < MAX_WORLD_DISTANCE:
            self.rejected["implausible pose"] += 1
            return False
        if not self.events or t > self.t + MAX_GAP:
            return self._start(t, pose)
        if self.lost_reason(t) and self._is_other_body(t, pose):  # the gate may be too wide
            return False
        if self._insert(t, POSE, pose):
            self.last_pose_time, self._candidate = max(self.last_pose_time, t), None
            return True
        return t > self.events[0].t and self._restart_if_settled(t, pose)

    def update_rate(self, t: int, omega: float) -> bool:
        """Update with a gyro sample [rad/s] taken at t [ns]; return True if it was accepted."""
        if not isfinite(omega):
            self.rejected["gyro not finite"] += 1
            return False
        if not self.events or not self._insert(t, RATE, (omega, 0.0, 0.0)):
            return False
        self.last_rate_time = max(self.last_rate_time, t)
        return True

    def recompute_since(self, t: int) -> None:
        """Recompute the estimates after t [ns], because known inputs since then have changed."""
        if self.events and (later := self._pop_after(t)):
            self._apply(later)

    def predict(self, t: int) -> None:
        """Predict to t [ns] without a measurement."""
        while self.events and self.t < t:
            self._apply([_Measurement(min(self.t + MAX_STEP, t), TIME_ONLY, NO_MEASUREMENT)])

    def state(self) -> BodyState:
        """Return the newest estimate.

        Its covariance includes volume_error, which averaging does not reduce.

        Raises:
            IndexError: there is no estimate yet.
        """
        (t, _, _), x, P = self.events[-1]
        return BodyState(t, x[:3], x[3:6], P[:6, :6] + self._volume_covariance)

    @property
    def bias(self) -> float:
        """Estimated bias of the gyro [rad/s]."""
        return float(self.events[-1].x[6])

    def add_push(self, t: int, speed: float, turn_rate: float) -> None:
        """Add the uncertainty of a push at t [ns], as standard deviations [m/s], [rad/s]."""
        if self.events:
            self._insert(t, PUSH, (speed**2, speed**2, turn_rate**2))

    def update_held_pose(self, t: int, pose: Pose) -> bool:
        """Update with the pose of the held body at t [ns]; return as `update_pose`."""
        return self._insert(t, HELD_POSE, pose) if self.events else self._start(t, pose)

    def distance(self, t: int, pose: Pose) -> float:
        """Return the Mahalanobis distance of a pose at t [ns] from the newest estimate."""
        last = self.events[-1]
        row = max(t - last.t, 0) * 1e-9, POSE, *pose
        _, _, out = self._run_steps(last, [last.t, t], [row], -1.0)
        return float(out[0, 0] ** 0.5)

    def lost_reason(self, t: int) -> str:
        """Return why the state at t [ns] counts as unknown; empty if it is known."""
        bounds = self.bounds
        if not self.events:
            return "not observed yet"
        if (outage := (t - self.last_pose_time) / SECOND) > bounds.max_outage:
            return f"not observed for {outage:.1f} s"
        P = self.events[-1].P
        for quantity, variance, bound, unit in (
            ("position", max(P[0, 0], P[1, 1]), bounds.max_position_deviation, "m"),
            ("heading", P[2, 2], bounds.max_heading_deviation, "rad"),
            ("speed", max(P[3, 3], P[4, 4]), bounds.max_speed_deviation, "m/s"),
        ):
            if not variance <= bound**2:
                sigma = f"{variance**0.5:.2g} {unit}"
                return (
                    f"{quantity} uncertain: 1 sigma is {sigma}, expected at most {bound:g} {unit}"
                )
        return ""

    def _start(self, t: int, pose: Pose) -> bool:
        """Start the filter at a pose; the number of full turns is kept."""
        e, turns = self.errors, 0.0
        if self.events:
            turns = 2.0 * pi * round((self.events[-1].x[2] - pose[2]) / (2.0 * pi))
        x = np.array([pose[0], pose[1], pose[2] + turns, 0.0, 0.0, 0.0, 0.0])
        deviations = e.position_error, e.position_error, e.heading_error, *INITIAL_SIGMA
        self.events.clear()
        self.events.append(
            _Event(_Measurement(t, TIME_ONLY, pose), x, np.diag(np.square(deviations)))
        )
        self.start_count, self.last_pose_time, self._candidate = self.start_count + 1, t, None
        return True

    def _insert(self, t: int, kind: float, z: Pose) -> bool:
        """Insert a measurement at its time and repeat the later ones.

        Returns:
            True if the measurement was used.
        """
        if not self.events[0].t < t <= self.t + MAX_GAP:
            self.rejected["late"] += 1
            return False
        later = self._pop_after(t) if t < self.t else ()
        square, used = self._apply([_Measurement(t, kind, z), *later])
        if used and kind in self.nis:
            self.nis[kind].append(square)
        elif not used and kind == RATE:
            self.rejected["gyro"] += 1
        return used

    def _pop_after(self, t: int) -> list[_Measurement]:
        """Remove the estimates after t [ns]; return their measurements, which must be repeated."""
        later = []
        while len(self.events) > 1 and self.events[-1].t > t:
            later.append(self.events.pop().measurement)
        return later[::-1]

    def _apply(self, measurements: Sequence[_Measurement]) -> tuple[float, bool]:
        """Process measurements in the order of time, from the newest estimate on.

        Returns:
            Squared normalized innovation of the first measurement, and whether that was used.
        """
        last = self.events[-1]
        times, rows, ends = [last.t], [], []
        for t, kind, z in measurements:
            while (
                t - times[-1] > MAX_STEP
            ):  # so that the heading is updated within a long prediction
                times.append(times[-1] + MAX_STEP)
                rows.append((MAX_STEP * 1e-9, TIME_ONLY, *NO_MEASUREMENT))
            rows.append(((t - times[-1]) * 1e-9, kind, *z))
            times.append(t)
            ends.append(len(rows) - 1)
        x, P, out = self._run_steps(last, times, rows)
        self.events += [_Event(one, x[k], P[k]) for one, k in zip(measurements, ends, strict=True)]
        while self.events[0].t < self.t - HISTORY_LENGTH and len(self.events) > 2:
            self.events.popleft()
        square, used, _ = out[ends[0]].tolist()
        return square, used > 0.0

    def _run_steps(
        self,
        last: _Event,
        times: Sequence[int],
        rows: Sequence[Sequence[float]],
        gate: float = GATE_SIGMA**2,
    ) -> tuple[Floats, Floats, Floats]:
        found: tuple[Floats, Floats, Floats] = _steps(
            last.x, last.P, *self.inputs.mean_accelerations(times), rows, gate, self._variances
        )
        return found

    def _is_other_body(self, t: int, pose: Pose) -> bool:
        """Return True if another body is at the pose."""
        (then, _, _), x, _ = self.events[-1]
        ahead = (t - then) * 1e-9
        off = hypot(pose[0] - x[0] - ahead * x[3], pose[1] - x[1] - ahead * x[4])
        if name := self.other_body_at(t, pose, off):
            self.rejected[f"pose of the {name}"] += 1
            self.last_mixup = t, name
        return bool(name)

    def _restart_if_settled(self, t: int, pose: Pose) -> bool:
        """Restart if rejected poses have agreed for the settle time; return True if so."""
        if self._is_other_body(t, pose):
            self._candidate = None
            return False
        self.rejected["pose"] += 1
        e, since = self.errors, t
        if self._candidate:
            first, last, before = self._candidate
            moved = hypot(pose[0] - before[0], pose[1] - before[1])
            agrees = 0 <= t - last < SECOND // 5
            if agrees and moved < 10.0 * e.position_error + MAX_SPEED * (t - last) / SECOND:
                since = first
        self._candidate = since, t, pose
        return t - since >= e.settle_time * SECOND and self._start(t, pose)
