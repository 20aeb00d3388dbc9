"""Known acceleration of the base: by the open valves and by the arm's motion.

    a = M (w - [h(q, qd)]_b) + B qdd_m,   M = H_bb^-1,  B = -M H_bm

in the base's axes, with the wrench w of the valves. The joints' accelerations are the changes of
their measured rates by time. The base reacts to the real motion of the joints and not to the
planned one, whichever node commands the arm and however well the drives follow. So an acceleration
is known once the next reading has arrived; the filter then recomputes the estimates since the last
one. Until then the planned accelerations are used, if a plan was received. In addition a joint may
change its rate as it did recently, which is modelled as noise.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.dynamics import write_bias, write_inertia
from fss_arm_model.kernels import kernel
from fss_arm_model.layout import count
from fss_arm_model.thrusters import THRUSTER_COUNT, thruster_wrenches
from fss_arm_model.units import SECOND

from .settings import EstimatorSettings
from .valve_faults import Faults

JOINT_TIMEOUT = 0.5  # after this time without a reading, a joint's motion is unknown [s]
PLAN_CORRELATION_TIME = 0.2  # of a joint's deviation from its plan [s]
MIN_RATE_CHANGE = 1e-4  # smaller changes of a joint's rate do not affect the base [rad/s]
CHANGE_WINDOW = 0.5  # window of recent changes of a joint's rate [s]
MIN_RATE_ERROR = 5e-4  # smallest error of a measured joint rate [rad/s]
JOINT_CHANGE_ERROR = 0.3  # of a constant acceleration between two readings, relative, 1 sigma
SILENT_JOINT_WALK = 0.05  # random walk of the rate of a joint without readings [rad/s/sqrt(s)]
MAX_JOINT_RATE = 100.0  # joint rate beyond which a reading is rejected [rad/s]
#: Number of stored readings of each joint, of valve commands and of points of a plan. At 50 a
#: second the first two span more than the filter's HISTORY_LENGTH, within which it may recompute.
MAX_READINGS, MAX_PULSES, MAX_PLAN_POINTS = 64, 64, 16
UNUSED, NO_END = -np.inf, np.inf  # times [s]


class Linearization(NamedTuple):
    """Point of linearization, and the error of the joints' rates."""

    t: float  # [s]
    omega: float  # turn rate of the base [rad/s]
    rate_error: float  # relative error of a joint's rate


class Prediction(NamedTuple):
    """Limits and errors of the known acceleration."""

    read_until: float  # time until which all joints were read [s]
    thrust_variance: float  # relative
    plan_variance: float  # of a planned acceleration, relative to its square


@kernel("(p),(n),(n,k),(n,k),(w),(w,w),(c)->(w,w),(w,n),(w),(w,w),(w,w)")
def _linearize(  # type: ignore[no-untyped-def]
    p,
    angles,
    read_at,
    rates,
    leak_wrench,
    base_noise,
    o,
    mobility,
    by_joint,
    bias_acceleration,
    read_density,
    unread_density,
):
    """Return M, B and M (w - h) at a time, and the noise before and after the last readings.

    Args:
        p: (8 + 6 n,) Arm.vector().
        angles: (n,) last readings [rad].
        read_at: (n, k) times of readings, the newest last [s].
        rates: (n, k) [rad/s].
        leak_wrench: (3,) wrench w of valves that stay open.
        base_noise: (3, 3) density of the noise that does not come from the joints.
        o: (3,) Linearization.
        mobility: (3, 3) M, written.
        by_joint: (3, n) B, written.
        bias_acceleration: (3,) M (w - h), written.
        read_density: (3, 3) density of the noise until all joints were read, written.
        unread_density: (3, 3) density of the noise after that, written.
    """
    at_point, n = Linearization(o[0], o[1], o[2]), angles.size
    q, qd, tau = np.zeros(3 + n), np.zeros(3 + n), np.zeros(3 + n)
    read_noise, noise_weight = np.empty(n), np.empty(n)
    qd[2] = at_point.omega
    for i in range(n):
        at, age = read_at[i], at_point.t - read_at[i, -1]
        is_recent = age <= JOINT_TIMEOUT
        qd[3 + i] = rates[i, -1] if is_recent else 0.0
        q[3 + i] = angles[i] + qd[3 + i] * (age if is_recent else 0.0)
        change = 0.0  # squared change between two readings by time, the larger of the last two
        for k in range(at.size - 2, at.size):
            if at[k - 1] > UNUSED:
                change = max(change, (rates[i, k] - rates[i, k - 1]) ** 2 / (at[k] - at[k - 1]))
        step = 2.0 * (at_point.rate_error * qd[3 + i]) ** 2 / PLAN_CORRELATION_TIME  # per reading
        read_noise[i] = step + JOINT_CHANGE_ERROR**2 * change
        noise_weight[i] = step + change if is_recent else SILENT_JOINT_WALK**2
    work, H = np.empty((3, n + 1), np.complex128), np.empty((3 + n, 3 + n))
    write_inertia(p, q, work, H)
    write_bias(p, q, qd, work, tau)
    M = np.linalg.inv(H[:3, :3])
    B = -M @ np.ascontiguousarray(H[:3, 3:])
    mobility[:], by_joint[:], bias_acceleration[:] = M, B, M @ (leak_wrench - tau[:3])
    read_density[:], unread_density[:] = (
        base_noise + B * read_noise @ B.T,
        base_noise + B * noise_weight @ B.T,
    )


@kernel("(),(),(n,k),(n,k),(p),(p,v),(v,w),(w,w),(w,n),(w),(w,w),(w,w),(q),(q,n),(c)->(w),(w,w)")
def _mean_acceleration(  # type: ignore[no-untyped-def]
    starts,
    ends,
    read_at,
    rates,
    opened,
    closed,
    valves,
    mobility,
    by_joint,
    bias_acceleration,
    read_density,
    unread_density,
    planned_at,
    planned,
    o,
    acceleration,
    noise,
):
    """Compute the mean acceleration (3,) and noise (3, 3) of the base in an interval, in its axes.

    The newest entries are last; unused times are UNUSED. `o` (3,) is a Prediction.
    """
    prediction = Prediction(o[0], o[1], o[2])
    start, end = starts[0], ends[0]
    span = end - start
    known_noise = unread_density if end > prediction.read_until else read_density
    for i in range(3):
        acceleration[i] = bias_acceleration[i]
        for j in range(3):
            noise[i, j] = known_noise[i, j]
    if span <= 0.0:
        return
    for joint in range(read_at.shape[0]):
        rate_change = noise_weight = 0.0
        for k in range(read_at.shape[1] - 1, 0, -1):
            first, last = read_at[joint, k - 1], read_at[joint, k]
            if first == UNUSED or last <= start:
                break
            overlap = min(end, last) - max(start, first)
            if overlap > 0.0:
                rate_change += (rates[joint, k] - rates[joint, k - 1]) * overlap / (last - first)
        if read_at[joint, -1] <= start:
            for k in range(planned_at.shape[0] - 1):
                overlap = min(end, planned_at[k + 1]) - max(start, planned_at[k])
                if overlap > 0.0:
                    rate_change += planned[k, joint] * overlap
            noise_weight = prediction.plan_variance * (rate_change / span) ** 2
        for i in range(3):
            acceleration[i] += by_joint[i, joint] * rate_change / span
            for j in range(3):
                noise[i, j] += by_joint[i, joint] * noise_weight * by_joint[j, joint]
    wrench, next_opened = np.zeros(3), end
    for k in range(opened.shape[0] - 1, -1, -1):
        pulse_start = max(start, opened[k])
        for valve in range(valves.shape[0]):
            open_time = min(closed[k, valve], next_opened) - pulse_start
            if open_time > 0.0:
                for i in range(3):
                    wrench[i] += valves[valve, i] * open_time / span
        next_opened = min(next_opened, opened[k])
        if opened[k] <= start:
            break
    thrust = np.zeros(3)
    for i in range(3):
        for j in range(3):
            thrust[i] += mobility[i, j] * wrench[j]
        acceleration[i] += thrust[i]
    for i in range(3):
        square = thrust[2] ** 2 if i == 2 else thrust[0] ** 2 + thrust[1] ** 2
        noise[i, i] += prediction.thrust_variance * square


class KnownInputs:
    """History of valve pulses and joint readings, and the newest plan for the joints.

    Args:
        p: (8 + 6 n,) Arm.vector().
        settings: thrusters, and errors of thrust and joint rates.
    """

    def __init__(self, p: npt.ArrayLike, settings: EstimatorSettings | None = None) -> None:
        self.settings = s = settings or EstimatorSettings()
        self.valves = thruster_wrenches(s.thrust, s.thruster_lever)
        self._working_valves, self._leak_wrench, self.faults = self.valves, np.zeros(3), Faults()
        self._base_noise = np.diag(
            np.square([s.acceleration, s.acceleration, s.angular_acceleration])
        )
        self._opened, self._closed = (
            np.full(MAX_PULSES, UNUSED),
            np.full((MAX_PULSES, THRUSTER_COUNT), UNUSED),
        )
        self._prediction = Prediction(
            0.0, s.thrust_error**2, JOINT_CHANGE_ERROR**2 * PLAN_CORRELATION_TIME
        )
        self._origin: int | None = None  # time at which the times in the arrays are zero [ns]
        self._reset_joints(count(np.asarray(p)))
        self.set_parameters(p)

    def _reset_joints(self, n: int) -> None:
        """Reset to n joints without readings or plan."""
        self.n = n
        self._read_at, self._rates = np.full((n, MAX_READINGS), UNUSED), np.zeros((n, MAX_READINGS))
        self._angles = np.zeros(n)
        self._model_time, self._model_omega = UNUSED, 0.0  # point of linearization
        self._planned_at, self._planned_accelerations = (
            np.full(MAX_PLAN_POINTS, UNUSED),
            np.zeros((MAX_PLAN_POINTS, n)),
        )

    def _seconds(self, t: int) -> float:
        """Return a time [ns] in the unit and from the origin of the arrays [s]."""
        if self._origin is None:
            self._origin = t
        return (t - self._origin) * 1e-9

    def set_parameters(self, p: npt.ArrayLike) -> None:
        """Use new parameters (8 + 6 n,), after a calibration or with a held body."""
        self.p = np.asarray(p, dtype=float)
        if count(self.p) != self.n:
            self._reset_joints(count(self.p))
        self._linearize_at(self._model_time, self._model_omega)

    def set_valve_faults(self, faults: Faults) -> None:
        """Predict with valves that stay open or closed, whatever their commands are."""
        self.faults = faults
        self._leak_wrench = self.valves[list(faults.open)].sum(axis=0)
        self._working_valves = self.valves.copy()
        self._working_valves[list(faults.open | faults.closed)] = 0.0
        self._linearize_at(self._model_time, self._model_omega)

    def add_pulses(self, t: int, on_times: npt.ArrayLike) -> bool:
        """Store a command to the valves; it replaces the one before.

        Args:
            t: when it was sent [ns].
            on_times: (8,) on-time of each valve [s].

        Returns:
            False if it was ignored: a number is invalid, or a later command is known.
        """
        times = np.asarray(on_times, dtype=float)
        if times.shape != (THRUSTER_COUNT,) or not (np.isfinite(times) & (times >= 0.0)).all():
            return False
        start = self._seconds(t) + self.settings.valve_delay
        if start <= self._opened[-1]:
            return False
        self._opened[:-1], self._closed[:-1] = self._opened[1:], self._closed[1:]
        self._opened[-1], self._closed[-1] = start, start + times
        return True

    def add_joint_reading(self, i: int, t: int, q: float, qd: float, omega: float) -> int | None:
        """Store a reading of a joint.

        Args:
            i: the joint, from 0.
            t: when it was read [ns].
            q: angle of the joint [rad].
            qd: rate of the joint [rad/s].
            omega: turn rate of the base then [rad/s].

        Returns:
            The time since when the known acceleration differs from what it was before the reading
            [ns]; None if it does not differ, or the reading was ignored.
        """
        at, rates = self._read_at[i], self._rates[i]
        now = self._seconds(t)
        if not (isfinite(q) and abs(qd) < MAX_JOINT_RATE) or now <= at[-1]:
            return None
        before = float(at[-1])
        if now - before > JOINT_TIMEOUT:  # its motion in the meantime is unknown
            at[:], before, rates[-1] = UNUSED, now, qd
        changed = abs(qd - rates[-1]) > MIN_RATE_CHANGE
        at[:-1], rates[:-1] = at[1:], rates[1:]
        at[-1], rates[-1], self._angles[i] = now, qd, q
        self._linearize_at(max(now, self._model_time), omega)
        return t - round((now - before) * SECOND) if changed else None

    def set_plan(self, stamp: int, ahead: Floats, rates: Floats) -> None:
        """Store a plan of the joints' rates; it replaces the one before.

        Args:
            stamp: when it starts [ns].
            ahead: (k,) increasing times since then [s]; only the first MAX_PLAN_POINTS are used.
            rates: (k, n) of the joints at these times [rad/s].
        """
        t, qd = self._seconds(stamp) + ahead[:MAX_PLAN_POINTS], rates[:MAX_PLAN_POINTS]
        k = len(t)
        self._planned_at[:], self._planned_accelerations[:] = UNUSED, 0.0
        if k > 1:
            self._planned_at[-k:] = t
            self._planned_accelerations[-k:-1] = np.diff(qd, axis=0) / np.diff(t)[:, None]

    def open_times(self, start: int, end: int) -> Floats:
        """Return how long each valve was open from one time [ns] to another, (8,) [s].

        Only the last MAX_PULSES commands are stored.
        """
        first, last = self._seconds(start), self._seconds(end)
        next_opened = np.append(self._opened[1:], NO_END)
        closed = np.minimum(np.minimum(self._closed, next_opened[:, None]), last)
        open_time = np.maximum(closed - np.maximum(self._opened, first)[:, None], 0.0)
        found: Floats = open_time.sum(axis=0)
        found[list(self.faults.open)], found[list(self.faults.closed)] = last - first, 0.0
        return found

    @property
    def all_joints_read(self) -> bool:
        """True if every joint has been read."""
        return bool((self._read_at[:, -1] > UNUSED).all())

    def joints_are_recent(self, t: int) -> bool:
        """Return True if every joint was read less than JOINT_TIMEOUT before t [ns]."""
        return self.all_joints_read and bool(
            (self._read_at[:, -1] > self._seconds(t) - JOINT_TIMEOUT).all()
        )

    def joints_at(self, t: int) -> tuple[Floats, Floats]:
        """Return extrapolated angles [rad] and rates [rad/s] of the joints at t [ns], (n,) each."""
        return self._extrapolated(self._seconds(t))

    def _extrapolated(self, t: float) -> tuple[Floats, Floats]:
        age = t - self._read_at[:, -1]
        qd = np.where(age <= JOINT_TIMEOUT, self._rates[:, -1], 0.0)
        return self._angles + qd * np.where(age <= JOINT_TIMEOUT, age, 0.0), qd

    def joint_rate_deviations(self) -> Floats:
        """Return standard deviations of the joints' rates, (n,) [rad/s].

        They include recent changes of the rates, because the filter needs the time CHANGE_WINDOW
        to measure the real reaction of the joints.
        """
        recent = np.where(
            self._read_at > self._read_at[:, -1:] - CHANGE_WINDOW, self._rates, np.nan
        )
        change = np.nanmax(recent, axis=1) - np.nanmin(recent, axis=1)
        found: Floats = (
            MIN_RATE_ERROR + self.settings.joint_rate_error * np.abs(recent[:, -1]) + change
        )
        return found

    def _linearize_at(self, t: float, omega: float) -> None:
        """Linearize about the joints' state at t [s], with the base's turn rate omega [rad/s]."""
        self._model_time, self._model_omega, s = t, omega, self.settings
        at = t if t > UNUSED else 0.0
        point = Linearization(at, omega, s.joint_rate_error)
        (
            self.mobility,
            self._by_joint,
            self._bias_acceleration,
            self._read_noise,
            self._unread_noise,
        ) = _linearize(
            self.p,
            self._angles,
            self._read_at,
            self._rates,
            self._leak_wrench,
            self._base_noise,
            point,
        )
        newest = self._read_at[:, -1].tolist()
        self._prediction = self._prediction._replace(read_until=min(newest))
        # Time at which the next joint counts as silent.
        recent = (read_at for read_at in newest if at - read_at <= JOINT_TIMEOUT)
        self._next_timeout = min(recent, default=NO_END) + JOINT_TIMEOUT

    def mean_accelerations(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return the mean acceleration of the base and its noise, in its own axes; see Inputs."""
        until = self._seconds(times[-1])
        if until > self._next_timeout and until > self._model_time:
            if len(times) > 2:  # one by one, as joints become silent in between
                parts = [self.mean_accelerations(pair) for pair in pairwise(times)]
                means, noises = zip(*parts, strict=True)
                return np.concatenate(means), np.concatenate(noises)
            self._linearize_at(until, self._model_omega)
        t = np.array([self._seconds(at) for at in times])
        found: tuple[Floats, Floats] = _mean_acceleration(
            t[:-1],
            t[1:],
            self._read_at,
            self._rates,
            self._opened,
            self._closed,
            self._working_valves,
            self.mobility,
            self._by_joint,
            self._bias_acceleration,
            self._read_noise,
            self._unread_noise,
            self._planned_at,
            self._planned_accelerations,
            self._prediction,
        )
        return found
