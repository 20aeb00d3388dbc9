"""The reach by sampling: model predictive path integral control over free-floating rollouts.

A plan of joint rates over a horizon is disturbed at random, each disturbed one is rolled out with
the momentum that base and arm have, and the plan becomes their mean, weighted by

    w_k = exp(-(S_k - min S) / lambda) / sum                (Williams, Aldrich, Theodorou 2017)

The cost S counts the end effector's distance from the fixture where that will be, its angle, the
turning of the base, ends of the joints' ranges, and what comes nearer to the target than it may.
Rates give the motion: no force acts, and momentum (px, py, L) stays (momentum.py).
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.clearance import GRIPPER, TARGET, _gap, _pivots, sizes
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import _join
from fss_arm_model.kernels import kernel
from fss_arm_model.kinematics import _chain, _dot
from fss_arm_model.layout import TIP_ANGLE
from fss_arm_model.momentum import momentum
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.reach import fixtures, limited

Floats = npt.NDArray[np.float64]

STEP, STEPS, SAMPLES = 0.15, 20, 384  # [s]
SPREAD, MEMORY = 0.12, 0.8  # of the disturbance [rad/s], and from one step to the next
TEMPERATURE = 0.02  # lambda
#: Weights: of distance^2, angle^2, base's turning^2, rates^2, ends of ranges^2, nearness^2
WEIGHTS = np.array([60.0, 0.35, 0.02, 0.01, 20.0, 400.0])
ROOM = 0.02  # from the end of a joint's range, which the plan keeps [rad], and to the target [m]
PERIOD = 0.1  # of the guidance, by which the plan is older at each call [s]


@kernel("(p),(m),(t),(h,n),(h,n),(h,a),(l,n),(s),(w),()->()")
def _cost(p, q0, P, plan, noise, ahead, limits, sizes, weights, step, out):  # type: ignore[no-untyped-def]
    n = q0.size - 3
    d, e = np.empty((2, n + 1), np.complex128)
    S = np.empty(n + 1, np.complex128)
    K, r, rate = np.empty(n + 1), np.empty(n + 2, np.complex128), np.empty(n)
    q = q0.copy()
    cost = 0.0
    for t in range(plan.shape[0]):
        _chain(p, q, d, e)
        M, first, second = 0.0, 0j, 0.0
        for k in range(n, -1, -1):
            M, first, second = _join(p, k, d, e, M, first, second)
            S[k], K[k] = first, second
        com = S[0] / M
        about = K[0] - _dot(com, S[0])
        _pivots(q, d, r)
        omega, v, effort = P[2], complex(P[0], P[1]) / M, 0.0
        for j in range(n):
            # Beside the plan's ends only the disturbance is limited, so that it explores
            rate[j] = min(max(plan[t, j] + noise[t, j], -limits[2, j]), limits[2, j])
            omega -= (K[j + 1] + _dot(r[j + 1] - r[0] - com, S[j + 1])) * rate[j]
            v -= 1j * rate[j] * S[j + 1] / M
            effort += rate[j] * rate[j]
        omega /= about
        v -= 1j * omega * com
        q[0] += step[0] * v.real
        q[1] += step[0] * v.imag
        q[2] += step[0] * omega
        heading, beyond = q[2], 0.0
        for j in range(n):
            q[3 + j] += step[0] * rate[j]
            over = max(q[3 + j] - limits[1, j], 0.0) + max(limits[0, j] - q[3 + j], 0.0)
            beyond += over * over
        _chain(p, q, d, e)
        _pivots(q, d, r)
        x, y = ahead[t, 0] - r[n + 1].real, ahead[t, 1] - r[n + 1].imag
        last = d[n]
        heading = np.arctan2(last.imag, last.real) + limits[3, 0]
        askew = (ahead[t, 2] - heading + np.pi) % (2.0 * np.pi) - np.pi
        near, middle = 0.0, complex(ahead[t, 3], ahead[t, 4])
        for body in range(n + 2):
            least = -0.03 if body == n + GRIPPER else limits[3, 1]
            gap = _gap(body, n + TARGET, r, middle, sizes)
            near += max(least - gap, 0.0) ** 2
        cost += step[0] * (
            weights[0] * (x * x + y * y)
            + weights[1] * askew * askew
            + weights[2] * omega * omega
            + weights[3] * effort
            + weights[4] * beyond
            + weights[5] * near
        )
        if t == plan.shape[0] - 1:
            cost += weights[0] * (x * x + y * y) + weights[1] * askew * askew
    out[0] = cost


class Predictive:
    """By sampling; the disturbances are drawn once, so that the answer repeats itself."""

    def __init__(self, arm: Arm, settings: MissionSettings) -> None:
        self.p, self.settings = arm.vector(), settings
        links = arm.links
        self.lowest = np.array([link.q_min for link in links])
        self.highest = np.array([link.q_max for link in links])
        most = np.full(arm.n, settings.joint_rate)
        other = np.zeros(arm.n) if arm.n > 1 else np.zeros(2)
        other[0], other[1] = self.p[TIP_ANGLE], settings.least_target + ROOM
        self._limits = np.stack([self.lowest + ROOM, self.highest - ROOM, most, other])
        self._sizes = sizes(settings, settings.target_radius, settings.gripper_length)
        white = np.random.default_rng(0).standard_normal((SAMPLES, STEPS, arm.n))
        for t in range(1, STEPS):
            white[:, t] = MEMORY * white[:, t - 1] + np.sqrt(1.0 - MEMORY**2) * white[:, t]
        self._noise = SPREAD * white
        self._noise[0] = 0.0
        self._times: Floats = STEP * np.arange(1.0, STEPS + 1.0)
        self.plan, self.momentum = np.zeros((STEPS, arm.n)), np.zeros(3)

    def begin(self, q: Floats, qd: Floats) -> None:
        """See Reach."""
        self.momentum, self.plan = momentum(self.p, q, qd), np.zeros_like(self.plan)

    def rates(self, q: Floats, state: Floats) -> Floats:
        """See Reach."""
        ahead = np.zeros((STEPS, 5))
        ahead[:, :3] = fixtures(state, self.settings, self._times)
        ahead[:, 3:] = state[0, :2] + self._times[:, None] * state[1, :2]
        for _ in range(2):
            cost = _cost(
                self.p, q, self.momentum, self.plan, self._noise, ahead, self._limits,
                self._sizes, WEIGHTS, STEP,
            )  # fmt: skip
            weight = np.exp(-(cost - cost.min()) / TEMPERATURE)
            change = np.tensordot(weight / weight.sum(), self._noise, axes=1)
            most = self.settings.joint_rate
            self.plan = np.clip(self.plan + change, -most, most)
        rates = self.plan[0].copy()
        share = PERIOD / STEP  # the plan moves on by less than its step
        self.plan[:-1] = (1.0 - share) * self.plan[:-1] + share * self.plan[1:]
        return limited(rates, q[3:], self.lowest, self.highest, self.settings.joint_rate)
