"""Holding the base at a pose, or along a path of poses, while the arm moves.

With base coordinates x (x, y, theta) and the joints' q_m, the wrench at the base's origin that
makes the base accelerate by a while the joints do what they are planned to do is (dynamics.py)

    w = H_bb a + [H_bm qdd_m + h(q, qd)]_b

of which the bracket is the arm's reaction. The acceleration follows the reference r:

    a = r'' + 2 zeta w_n (r' - x') + w_n^2 (r - x) + d,   d' = k_i w_n^3 (r - x)

so that gains follow from a bandwidth w_n and from the mass and inertia of the present posture; d
balances what is not modelled: the table's slope, the hose.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix, inverse_dynamics
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, setting
from fss_gnc.reference import Reference, off

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PoseGains(Settings):
    """How the base follows its reference."""

    bandwidth: float = setting(
        0.35, "bandwidth of the base's control", unit="rad/s", check=POSITIVE
    )
    damping: float = setting(0.9, "damping ratio of the base's control", check=POSITIVE)
    integral: float = setting(
        0.1, "share of the bandwidth at which steady disturbances are balanced", check=NOT_NEGATIVE
    )
    max_disturbance: float = setting(
        0.005, "most acceleration that is balanced as a steady disturbance", unit="m/s^2",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    max_offset: float = setting(
        0.2, "offset from the reference above which the base is drawn there no harder", unit="m",
        check=POSITIVE,
    )  # fmt: skip


class PoseControl:
    """From where base and arm are to the wrench on the base."""

    def __init__(self, arm: Arm, gains: PoseGains | None = None) -> None:
        self.p, self.gains = arm.vector(), gains or PoseGains()  # p as it is now
        self.reset()

    def reset(self) -> None:
        """Forget the steady disturbance."""
        self._disturbance = np.zeros(3)

    def wrench(
        self,
        q: npt.ArrayLike,
        qd: npt.ArrayLike,
        reference: Reference,
        period: float,
        qdd_m: npt.ArrayLike | None = None,
    ) -> Floats:
        """Force in the base's axes [N] and torque about its origin [N m], (3,).

        Args:
            q: (3 + n,) state.
            qd: (3 + n,) its rate.
            reference: where the base is to be; its heading is taken the shorter way.
            period: since the last call [s].
            qdd_m: (n,) planned accelerations of the joints [rad/s^2]; None: the arm's reaction is
                left to be felt.
        """
        q, qd, g = np.asarray(q, float), np.asarray(qd, float), self.gains
        apart = off(reference.pose, q[:3])
        apart[:2] *= min(1.0, g.max_offset / max(float(np.hypot(*apart[:2])), 1e-9))
        w_n = g.bandwidth
        self._disturbance += period * g.integral * w_n**3 * apart
        np.clip(self._disturbance, -g.max_disturbance, g.max_disturbance, out=self._disturbance)
        slow = 2.0 * g.damping * w_n * (reference.twist - qd[:3])
        a = reference.acceleration + slow + w_n**2 * apart + self._disturbance
        wrench = inertia_matrix(self.p, q)[:3, :3] @ a
        if qdd_m is not None:
            still = np.concatenate([np.zeros(3), qdd_m])
            wrench += inverse_dynamics(self.p, q, qd, still)[:3]
        turn = np.exp(-1j * q[2]) * complex(wrench[0], wrench[1])
        return np.array([turn.real, turn.imag, wrench[2]])
