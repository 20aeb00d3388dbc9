"""What is known to accelerate the base: the valves that are open, and the arm's motion.

    a = M (w - [h(q, qd)]_b) + B qdd_m,   M = H_bb^-1,  B = -M H_bm

in the base's axes, with the wrench w of the valves. The joints' accelerations are those that their
readings show, change of rate by time: whoever moves the arm, and however its drives follow, the
base feels what the joints do and not what was planned. So they are known when the next reading has
come, and the filter takes what followed the last one again. Until then they are those planned, if a
plan is heard; and a joint may change beside it as it did of late, which is noise.
"""

from collections import deque
from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.dynamics import inertia_matrix, inverse_dynamics
from fss_arm_model.kernels import Floats
from fss_arm_model.thrusters import layout

from .settings import EstimatorSettings

SECOND = 1_000_000_000
KEPT = 2 * SECOND  # of pulses, for measurements that come late
UNHEARD = SECOND // 2  # a joint that is silent for longer may do anything
FOREVER = 1 << 62  # [ns]
RESTS = 1e-4  # change of a joint's rate that the base does not feel [rad/s]


class _Pulses(NamedTuple):
    """The valves from one command to the next."""

    begin: int  # [ns]
    ends: tuple[int, ...]  # of each valve that is to open
    wrenches: tuple[tuple[float, float, float], ...]  # of each


class _Joint:
    """One joint's newest readings."""

    def __init__(self) -> None:
        self.t: deque[int] = deque(maxlen=8)
        self.qd: deque[float] = deque(maxlen=8)
        self.q = 0.0

    def changed(self, begin: int, end: int) -> float:
        """By how much its rate changes from one time to another, straight between readings."""
        t, qd, change = self.t, self.qd, 0.0
        for k in range(len(t) - 1, 0, -1):
            if t[k] <= begin:
                break
            overlap = min(end, t[k]) - max(begin, t[k - 1])
            if overlap > 0:
                change += (qd[k] - qd[k - 1]) * overlap / (t[k] - t[k - 1])
        return change

    def density(self) -> float:
        """The square of its change between two readings, by time: the larger of the last two."""
        t, qd = self.t, self.qd
        return max(
            (
                (qd[k] - qd[k - 1]) ** 2 / ((t[k] - t[k - 1]) * 1e-9)
                for k in range(len(t) - 1, max(len(t) - 3, 0), -1)
            ),
            default=0.0,
        )


class _Plan(NamedTuple):
    """What the joints are to do."""

    t: list[int]  # [ns]
    qd: Floats  # (k, n) rates, straight between these times


class KnownInputs:
    """Remembers pulses of the valves and readings of the joints, and the newest plan for them.

    Args:
        p: (8 + 6 n,) Arm.vector().
        settings: thrusters, and how well thrust and joints are known.
    """

    def __init__(self, p: npt.ArrayLike, settings: EstimatorSettings | None = None) -> None:
        self.settings = s = settings or EstimatorSettings()
        self.valves = layout(s.thrust, s.thruster_lever)
        self.delay = round(SECOND * s.valve_delay)
        self._pulses: deque[_Pulses] = deque()
        self._plan: _Plan | None = None
        self._quiet = np.diag(np.square([s.acceleration, s.acceleration, s.angular_acceleration]))
        self.describe(p)

    def describe(self, p: npt.ArrayLike) -> None:
        """The arm is another: a calibration passed, or the gripper holds something."""
        self.p = np.asarray(p, dtype=float)
        n = (len(self.p) - 8) // 6
        if n != len(getattr(self, "joints", ())):
            self.joints = [_Joint() for _ in range(n)]
        self._model(-1, 0.0)

    def pulses(self, t: int, on_times: npt.ArrayLike) -> bool:
        """Valves open for a time each [s], from t [ns] on; these replace those before."""
        times = np.asarray(on_times, dtype=float)
        if times.shape != (len(self.valves),) or not (np.isfinite(times) & (times >= 0.0)).all():
            return False
        if self._pulses and t <= self._pulses[-1].begin - self.delay:
            return False
        opened = np.flatnonzero(times)
        begin = t + self.delay
        self._pulses.append(
            _Pulses(
                begin,
                tuple(begin + int(SECOND * times[k]) for k in opened),
                tuple(map(tuple, self.valves[opened].tolist())),
            )
        )
        while self._pulses[0].begin < t - KEPT and len(self._pulses) > 1:
            self._pulses.popleft()
        return True

    def joint(self, i: int, t: int, q: float, qd: float, omega: float) -> int | None:
        """Take a reading of joint i, from 0, at t [ns], the base turning at omega [rad/s].

        Returns:
            Since when what is known is another than it was [ns]; None: it is as it was.
        """
        joint = self.joints[i]
        if not (isfinite(q) and isfinite(qd)) or (joint.t and t <= joint.t[-1]):
            return None
        if joint.t and t - joint.t[-1] > UNHEARD:
            joint.t.clear()
            joint.qd.clear()
        before, was = (joint.t[-1], joint.qd[-1]) if joint.t else (t, qd)
        joint.t.append(t)
        joint.qd.append(qd)
        joint.q = q
        self._model(max(t, self._newest), omega)
        return before if abs(qd - was) > RESTS else None

    def plan(self, times: Sequence[int], rates: npt.ArrayLike) -> bool:
        """The joints are to have rates (k, n) [rad/s] at times [ns]; False: that is no plan."""
        t, qd = list(times), np.asarray(rates, dtype=float)
        if qd.shape != (len(t), len(self.joints)) or not np.isfinite(qd).all() or t != sorted(t):
            return False
        self._plan = _Plan(t, qd) if len(t) > 1 else None
        return True

    def _planned(self, begin: int, end: int) -> Floats | None:
        """By how much the joints' rates are to change meanwhile; None: nothing is planned."""
        if self._plan is None or not self._plan.t[0] <= begin < end <= self._plan.t[-1]:
            return None
        t, qd = self._plan
        first, last = (
            np.array([np.interp(at, t, column) for column in qd.T]) for at in (begin, end)
        )
        return last - first

    @property
    def heard(self) -> bool:
        """Whether every joint was."""
        return all(joint.t for joint in self.joints)

    def heard_at(self, t: int) -> bool:
        """Whether every joint was within UNHEARD before t [ns]."""
        return all(joint.t and t - joint.t[-1] <= UNHEARD for joint in self.joints)

    def joints_at(self, t: int) -> tuple[Floats, Floats]:
        """Angles and rates of the joints at t [ns], (n,) each, by their newest readings."""
        q, qd = np.zeros((2, len(self.joints)))
        for i, joint in enumerate(self.joints):
            q[i] = joint.q
            if joint.t and t - joint.t[-1] <= UNHEARD:
                qd[i] = joint.qd[-1]
                q[i] += qd[i] * (t - joint.t[-1]) * 1e-9
        return q, qd

    def _model(self, t: int, omega: float) -> None:
        """Linearize about the joints as they are at t [ns], the base turning at omega [rad/s]."""
        self._newest, self._omega, s = t, omega, self.settings
        heard = [bool(joint.t) and t - joint.t[-1] <= UNHEARD for joint in self.joints]
        angles, rates = self.joints_at(t)
        q, qd = np.append(np.zeros(3), angles), np.append([0.0, 0.0, omega], rates)
        H = inertia_matrix(self.p, q)
        self.mobility = np.linalg.inv(H[:3, :3])
        self._by_joint = -self.mobility @ H[:3, 3:]
        still = np.zeros(len(q))
        self._still = -self.mobility @ inverse_dynamics(self.p, q, qd, still)[:3]
        step = 2.0 * (s.joint_rate_error * qd[3:]) ** 2 / 0.2  # by readings, each 0.2 s or so
        late = np.array([joint.density() for joint in self.joints])
        even = step + s.joint_change_error**2 * late
        loose = np.where(heard, step + late, s.unheard_change**2)
        self._read = self._quiet + self._by_joint * even @ self._by_joint.T
        self._tail = self._quiet + self._by_joint * loose @ self._by_joint.T
        newest = [joint.t[-1] if joint.t else -1 for joint in self.joints]
        self._from, self._until = min(newest), max(newest)
        self._silent = min(
            (last for last, h in zip(newest, heard, strict=True) if h), default=FOREVER
        )
        self._silent += UNHEARD  # when the next one falls silent

    def over(self, begin: int, end: int) -> tuple[Floats, Floats]:
        """The mean acceleration of the base and its noise, in its own axes; see Inputs."""
        if end > max(self._silent, self._newest):
            self._model(end, self._omega)
        a, noise = self._still, self._tail if end > self._from else self._read
        changes = None
        if begin < self._until and end > begin:
            changes = np.array([joint.changed(begin, end) for joint in self.joints])
        if end > self._from and (planned := self._planned(begin, end)) is not None:
            # Of joints that were not read since; a reading within counts up to its time.
            unread = [joint.t[-1] <= begin if joint.t else True for joint in self.joints]
            planned = planned * unread
            off = self.settings.joint_change_error**2 * planned**2 / ((end - begin) * 1e-9)
            noise = noise + self._by_joint * off @ self._by_joint.T
            changes = planned if changes is None else planned + changes
        if changes is not None:
            a = a + self._by_joint @ changes / ((end - begin) * 1e-9)
        wrench = self._wrench(begin, end)
        if wrench is not None:
            thrust = self.mobility @ wrench
            a = a + thrust
            off = self.settings.thrust_error**2
            line, turn = off * (thrust[0] ** 2 + thrust[1] ** 2), off * thrust[2] ** 2
            noise = noise + np.diag([line, line, turn])
        return a, noise

    def _wrench(self, begin: int, end: int) -> list[float] | None:
        """The mean wrench of the valves; None: none is open."""
        if end <= begin:
            return None
        x = y = turn = 0.0
        following = end
        for pulses in reversed(self._pulses):
            since = max(begin, pulses.begin)
            for close, (fx, fy, torque) in zip(pulses.ends, pulses.wrenches, strict=True):
                if (open_for := min(close, following) - since) > 0:
                    x, y, turn = x + open_for * fx, y + open_for * fy, turn + open_for * torque
            following = min(following, pulses.begin)
            if pulses.begin <= begin:
                break
        if x == y == turn == 0.0:
            return None
        return [x / (end - begin), y / (end - begin), turn / (end - begin)]
