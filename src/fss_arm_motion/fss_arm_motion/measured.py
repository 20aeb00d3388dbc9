"""Measured state of arm and base, and the start of a plan from it."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.momentum import momentum
from fss_arm_model.units import SECOND
from fss_arm_motion.plan import Start
from fss_arm_motion.settings import MotionSettings
from fss_arm_motion.track import Track
from fss_arm_ros.calibrated import Calibrated

REST_WINDOW = 4.0  # time before a plan over which drifts are averaged [s]


class MotionError(ValueError):
    """A motion cannot start, or ended early; the message gives the reason."""


class Measured:
    """Newest state of all joints, and recent states of joints and base."""

    def __init__(self, settings: MotionSettings) -> None:
        self.settings = settings
        self.t = 0  # of the newest joint state [ns]; 0: none yet
        self.q: Floats = np.zeros(0)  # (n,) [rad]
        self.qd: Floats = np.zeros(0)  # (n,) [rad/s]
        self.joints, self.base = Track(), Track(angle=2)
        self.moved = 0  # time at which a joint last moved [ns]

    def add_joints(self, t: int, readings: Iterable[tuple[int, float, float, float]]) -> None:
        """Add number, q [rad], qd [rad/s] and effort [N m] of all joints at t [ns], unsorted."""
        rows, self.t = sorted(readings), t
        self.q, self.qd = (np.array([row[k] for row in rows]) for k in (1, 2))
        self.joints.add(t, self.q.tolist())
        if np.abs(self.qd).max(initial=0.0) > self.settings.motion_threshold:
            self.moved = t

    @property
    def has_rested(self) -> bool:
        """True if no joint has moved for the time over which drifts are averaged."""
        return self.t >= self.moved + round(REST_WINDOW * SECOND)

    @property
    def has_base(self) -> bool:
        """True if the base's drift is known; otherwise it is assumed to be at rest."""
        return self.base.drift(self.t, REST_WINDOW) is not None

    def start(self, now: int, calibrated: Calibrated) -> Start:
        """Return the initial state of a plan; a base without poses is assumed to be at rest.

        Args:
            now: time [ns].
            calibrated: the arm.

        Raises:
            MotionError: joint states are missing or too old, or the arm moves.
            PlanError: a joint is beyond its limits.
        """
        s, arm = self.settings, calibrated.arm
        if (age := (now - self.t) / SECOND) > s.max_age:
            problem = f"is {age:.1f} s old" if self.t else "was not received yet"
            raise MotionError(f"arm/joint_states {problem}: check that arm and all links run")
        if (count := len(self.q)) != arm.n:
            raise MotionError(f"arm/joint_states has {count} joints, the description {arm.n}")
        if (fast := np.abs(self.qd)).max() > s.motion_threshold:
            i = int(fast.argmax())
            raise MotionError(
                f"joint {i + 1} moves at {self.qd[i]:.3f} rad/s; wait until the arm rests"
            )
        start = Start(arm, self.q, covariance=calibrated.covariance, tracking=s.tracking)
        base = self.base.drift(self.t, REST_WINDOW)
        settling = self.joints.drift(self.t, REST_WINDOW)
        if base is None or settling is None:
            return start
        # Momentum by unit rates of base and joints; settling joints turn the base, too.
        q = np.concatenate([base.at, self.q])
        by_rates = momentum(arm.vector(), q, np.eye(3 + arm.n)).T
        C = np.zeros((6, 6))  # of pose and momentum
        C[3:, 3:] = by_rates[:, :3] @ base.covariance @ by_rates[:, :3].T
        P = by_rates @ np.concatenate([base.rate, settling.rate])
        return replace(start, pose=base.at, momentum=P, state_covariance=C)
