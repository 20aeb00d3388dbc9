"""Control of the base from the newest messages: it decides when the valves must stay closed."""

from math import inf

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.held import Target
from fss_arm_model.units import SECOND
from fss_gnc.control.craft_model import CraftModel
from fss_gnc.control.planned import PlannedRates
from fss_gnc.control.pose import PoseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.control.stall_hold import StallHold
from fss_gnc.latest import Latest, body_at
from fss_gnc.reference import Body, Path, Reference


class BaseControl:
    """Controller that makes the base follow a trajectory, whatever the arm does."""

    def __init__(self, arm: Arm, settings: ControlSettings) -> None:
        self.settings = s = settings
        self.pose_control, self.planned = PoseControl(arm, s), PlannedRates()
        self.model = CraftModel(arm, Target(s.target_mass, s.target_inertia))
        self.base = Latest[Body]("base/state", s.max_age)
        self.target = Latest[Body]("target/state", s.max_age)
        self.joints = Latest[Floats]("arm/joint_states", s.max_age)  # (3, n) q, qd, effort
        #: Time at which the path starts [ns], and the path; None: the valves stay closed.
        self.trajectory = Latest[tuple[int, Path | None]]("base/trajectory", s.timeout)
        self.hold = StallHold(s.max_pause, s.timeout)
        self.problem = ""  # why base or joints are unknown; empty: both are known
        self.active = False  # True if there was a wrench for the last period

    def load_kernels(self) -> None:
        """Load the kernels in advance, because that takes long."""
        n = self.model.arm.n
        zero = np.zeros(3 + n)
        self.pose_control.wrench(zero, zero, Reference.at_rest(zero[:3]), 1.0, zero[3:])

    def resume(self, pause: float) -> None:
        """Drop the reference, and what was received before the end of a stall [s]."""
        for topic in (self.base, self.target, self.joints, self.trajectory):
            topic.clear()
        self.hold.start(pause)

    def follow(self, now: int, stamp: int, path: Path | None) -> None:
        """Follow a path received at `now` from its stamp on [ns]; None: close the valves."""
        if self.hold.accepts(path is not None):
            self.trajectory.store(now, (stamp, path))

    def step(self, now: int) -> Floats | None:
        """Return the wrench from `now` [ns] on, for one period, (3,) as PoseControl.wrench.

        If the valves must close, it is zero once, then None.
        """
        self.hold.wait(1.0 / self.settings.rate)
        wrench, was_active = self._wrench(now), self.active
        self.active = wrench is not None
        if was_active and not self.active:
            self.pose_control.reset()
            self.planned.reset()
            return np.zeros(3)
        return wrench

    def _wrench(self, now: int) -> Floats | None:
        """Return the wrench for the next period; None if the valves must stay closed."""
        self.problem = self.base.problem(now) or self.joints.problem(now)
        base, joints = body_at(self.base, now), self.joints.value
        if base is None or joints is None:
            return None
        if (reference := self._reference(now, base)) is None:
            return None
        q_m, qd_m, _ = joints
        if self.joints.valid_value(now) is None:  # links stop without commands
            qd_m = np.zeros_like(qd_m)
        q = np.concatenate([base.pose, q_m + self.joints.age(now) * qd_m])
        target, period = body_at(self.target, now), 1.0 / self.settings.rate
        self.pose_control.p = self.model.parameters(q, target and target.pose)
        qdd_m = self.planned.accelerations(now, period) if self.settings.feed_forward else None
        return self.pose_control.wrench(
            q, np.concatenate([base.twist, qd_m]), reference, period, qdd_m
        )

    def _reference(self, now: int, base: Body) -> Reference | None:
        """Return the reference of the base; None if the valves must stay closed."""
        if self.hold.reason:
            return self.hold.reference(base)
        stamp, path = self.trajectory.valid_value(now) or (0, None)
        return None if path is None else path.at((now - stamp) / SECOND)

    def status(self, now: int) -> str:
        """Return in one sentence what it does at `now` [ns], and why."""
        if self.hold.reason:
            effect = "holding the base" if self.active else "thrusters idle"
            return f"{effect}: {self.hold.reason}; waiting for the end of base/trajectory"
        if self.problem:
            effect = "joints assumed at rest" if self.active else "thrusters idle"
            return f"{effect}: {self.problem}"
        if self.active:
            return "following base/trajectory"
        if self.trajectory.max_age < (age := self.trajectory.age(now)) < inf:
            return f"thrusters idle: no new base/trajectory for {age:.1f} s"
        reason = self.trajectory.problem(now) or "base/trajectory has no points"
        return f"thrusters idle: {reason}"
