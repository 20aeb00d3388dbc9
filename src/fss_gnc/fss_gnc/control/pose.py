"""Control of the base at a pose, or along a path of poses, while the arm moves.

Let x be the base coordinates (x, y, theta) and q_m the joint angles. If the joints move as planned,
the wrench at the base's origin that makes the base accelerate by a is (dynamics.py)

    w = H_bb a + [H_bm qdd_m + h(q, qd)]_b

where the bracket is the arm's reaction. The acceleration follows the reference r:

    a = r'' + 2 zeta w_n (r' - x') + w_n^2 (r - x) + d,   d' = k_i w_n^3 (r - x)

The gains follow from a bandwidth w_n and from the mass and inertia of the present posture. The
term d balances what is not modelled: the table's slope, the hose.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix, inverse_dynamics
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, setting
from fss_gnc.reference import Reference, pose_error


@dataclass(frozen=True)
class PoseGains(Settings):
    """Gains of the controller that makes the base follow its reference."""

    bandwidth: float = setting(
        0.35, "bandwidth of the base controller", unit="rad/s", check=POSITIVE
    )
    damping: float = setting(0.9, "damping ratio of the base controller", check=POSITIVE)
    integral: float = setting(
        0.1,
        "integral gain, as a fraction of bandwidth^3; compensates steady disturbances",
        check=NOT_NEGATIVE,
    )
    max_disturbance: float = setting(
        0.005,
        "largest acceleration of each axis that the integral term gives",
        unit="m/s^2, rad/s^2",
        check=NOT_NEGATIVE,
    )
    max_offset: float = setting(
        0.2,
        "position error above which the proportional term does not increase",
        unit="m",
        check=POSITIVE,
    )


class PoseControl:
    """Controller from the state of base and arm to the wrench on the base."""

    def __init__(self, arm: Arm, gains: PoseGains | None = None) -> None:
        self.p, self.gains = arm.vector(), gains or PoseGains()  # p: the present parameters
        self.reset()

    def reset(self) -> None:
        """Reset the estimate of the steady disturbance."""
        self._disturbance = np.zeros(3)

    def wrench(
        self,
        q: npt.ArrayLike,
        qd: npt.ArrayLike,
        reference: Reference,
        period: float,
        qdd_m: npt.ArrayLike | None = None,
    ) -> Floats:
        """Return force in the base's axes [N] and torque about its origin [N m], (3,).

        Args:
            q: (3 + n,) state.
            qd: (3 + n,) rate of the state.
            reference: of the base; the heading error is wrapped to the shorter turn.
            period: since the last call [s].
            qdd_m: (n,) planned accelerations of the joints [rad/s^2]; None: no feedforward of the
                arm's reaction.
        """
        q, qd, g = np.asarray(q, float), np.asarray(qd, float), self.gains
        error = pose_error(reference.pose, q[:3])
        error[:2] *= min(1.0, g.max_offset / max(float(np.hypot(*error[:2])), 1e-9))
        w_n = g.bandwidth
        self._disturbance += period * g.integral * w_n**3 * error
        np.clip(self._disturbance, -g.max_disturbance, g.max_disturbance, out=self._disturbance)
        damping = 2.0 * g.damping * w_n * (reference.twist - qd[:3])
        a = reference.acceleration + damping + w_n**2 * error + self._disturbance
        wrench = inertia_matrix(self.p, q)[:3, :3] @ a
        if qdd_m is not None:
            accelerations = np.concatenate([np.zeros(3), qdd_m])
            wrench += inverse_dynamics(self.p, q, qd, accelerations)[:3]
        force = np.exp(-1j * q[2]) * complex(wrench[0], wrench[1])
        return np.array([force.real, force.imag, wrench[2]])
