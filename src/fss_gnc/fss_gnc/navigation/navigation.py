"""Navigation of base and target together.

Motion capture may swap the two, and the gripper of one may hold the other.
"""

from collections import deque
from collections.abc import Sequence
from functools import partial
from math import expm1, hypot

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.held import Target, held, hold, with_held
from fss_arm_model.kernels import Floats
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_model.planar import wrap
from fss_arm_model.thrusters import COUNT

from .body_filter import GATE, BodyFilter, BodyState, Free, Pose
from .caught import SPACING, Caught, CaughtErrors, FreeBody, MassProperties, Sample
from .inputs import KnownInputs
from .settings import EstimatorSettings, TargetErrors
from .valve_faults import Faults, Moment, ValveFaults

SECOND = 1_000_000_000
SAME = 0.05, 0.15  # a pose this close to the end effector's counts as the end effector's [m], [rad]
UNSEEN = SECOND // 5  # longest time without a pose before the arm's is used [ns]
GRIP = 0.05, 0.1  # change of twists by a grip or a release, 1 sigma [m/s], [rad/s]
SHAKEN = 0.05, 0.2  # random walk of a held target's twist [m/s/sqrt(s)], [rad/s/sqrt(s)]
BEFORE = SECOND // 2  # longest delay of a grip's message, and time to calm down [ns]
EARLIER = 20  # stored samples before a grip, BEFORE apart
GAP = 2 * SECOND  # gap in the estimates after which the impulses of the valves are unknown [ns]
EASED = 0.05  # share by which a pose of the held target corrects its place in the gripper


class _Carried(Free):
    """Inputs of the target, which the arm accelerates while the gripper holds it."""

    def __init__(self, errors: TargetErrors) -> None:
        super().__init__(errors)
        self.held = False
        shaken = np.diag(np.square([SHAKEN[0], SHAKEN[0], SHAKEN[1]]))
        self._shaken = np.zeros((1, 3)), shaken[None]

    def over(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return zero acceleration; the noise is larger while the target is held."""
        return self._shaken if self.held else super().over(times)


class Navigation:
    """Filters of base and target.

    A pose is rejected if it fits another body, as when motion capture swaps base and target. It is
    reported under that body's name and not used.

    Args:
        arm: description of the arm.
        settings: errors of sensors and inputs.
        of_target: errors of the target's poses, and its process noise.
        body: assumed mass and inertia of the target.
        errors: uncertainty of the assumed mass and inertia, and random walk of the momentum.
    """

    def __init__(
        self,
        arm: Arm,
        settings: EstimatorSettings | None = None,
        of_target: TargetErrors | None = None,
        body: Target | None = None,
        errors: CaughtErrors | None = None,
    ) -> None:
        self.settings, self.body = settings or EstimatorSettings(), body or Target()
        self.p = arm.vector()
        self.inputs = KnownInputs(self.p, self.settings)
        of_target, s = of_target or TargetErrors(), self.settings
        self._carried = _Carried(of_target)
        self.base = BodyFilter(s, self.inputs, partial(self._other, "target"), s)
        self.target = BodyFilter(of_target, self._carried, partial(self._other, "base"), s)
        self.place: Floats | None = None  # place of the target in the gripper; None: it is not held
        self.errors = errors or CaughtErrors()
        self.caught: Caught | None = None
        self.found: MassProperties | None = None  # of the held body; None: not measured yet
        self._gripped = 0  # time of the grip's message [ns]
        self._seen: deque[tuple[int, Sample, BodyState | None]] = deque(maxlen=EARLIER)
        self.valves = ValveFaults(self.settings.thrust_error)
        # Impulses of each valve, as commanded and if always open, and until when they count [ns].
        self._given, self._given_until = np.zeros((2, COUNT, 3)), -GAP

    @property
    def holds(self) -> bool:
        """True if the gripper holds the target."""
        return self._carried.held

    def describe(self, arm: Arm) -> None:
        """Use a new description of the arm, as after a calibration."""
        self.p = arm.vector()
        if self.caught:
            self.caught.p = self.p
        self._weigh()

    def joint(self, i: int, t: int, q: float, qd: float) -> None:
        """Process a reading q [rad], qd [rad/s] of joint i, from 0, at t [ns]."""
        omega = self.base.state().twist[2] if self.base.events else 0.0
        since = self.inputs.joint(i, t, q, qd, float(omega))
        if since is not None:
            self.base.revise(since)

    def pulses(self, t: int, on_times: npt.ArrayLike) -> bool:
        """Process on-times (8,) [s] sent to the valves at t [ns]; return False if ignored."""
        taken = self.inputs.pulses(t, on_times)
        if taken:
            self.base.revise(t)
        return taken

    def confused(self, t: int) -> list[tuple[str, str]]:
        """Return pairs of bodies (name, other): one was seen at the other's pose within 1 s."""
        bodies = ("base", self.base), ("target", self.target)
        return [
            (name, body.confused[1])
            for name, body in bodies
            if body.confused and t - body.confused[0] < SECOND
        ]

    def target_pose(self, t: int, x: float, y: float, heading: float) -> bool:
        """Update with a pose [m, m, rad] of the target seen at t [ns]; return True if accepted."""
        believed = self.target.pose(t, x, y, heading)
        if believed and self.holds and not self.base.lost(t):
            place = hold(self.p, self._state(t)[0], (x, y, heading))
            if self.place is None:
                self.place = place
                self._weigh()
            else:
                off = place - self.place
                off[2] = wrap(off[2])
                self.place = self.place + EASED * off
        return believed

    def gripper(self, holds: bool) -> None:
        """Process the gripper's report that it holds the target, or does not."""
        if holds == self.holds:
            return
        self._carried.held, self.place, self._gripped = holds, None, self.base.t
        self.caught = self.found = None
        self.valves.forget()
        for body in (self.base, self.target):
            body.push(body.t, *GRIP)
        self._weigh()

    def predict(self, t: int) -> None:
        """Predict to t [ns]; a held target that is not seen moves with the gripper."""
        self.base.predict(t)
        if self.place is not None and t - self.target.seen > UNSEEN and not self.base.lost(t):
            x, y, heading = held(self.p, *self._state(t), self.place)[0].tolist()
            self.target.held(t, (x, y, heading))
        self.target.predict(t)

    def observe(self, t: int) -> MassProperties | None:
        """Estimate the mass properties of the held body at t [ns]; None unless they are new."""
        if not self._is_known(t) or (self.holds and t < self._gripped + BEFORE):
            return None
        if not self.holds and self._seen and t < self._seen[-1][0] + BEFORE:
            return None
        sample = self._sample(t)
        if not self.holds:
            free = self.target.events and not self.target.lost(t)
            self._seen.append((t, sample, self.target.state().at(t) if free else None))
            return None
        if self.caught is None:
            self.caught = self._begin(t, sample)
        if not self.caught.is_due(sample.t):
            return None
        self.caught.take(sample)
        found = self.caught.solve()
        if not self.caught.explained:  # no mass explains the motion: the last estimate is kept
            return None
        self.found = found
        self._weigh()
        return self.found

    def diagnose(self, t: int) -> Faults | None:
        """Detect faulty valves at t [ns]; return None unless the known faults have changed."""
        known, place = self.valves.found, self.place
        p, mass_error = self.p, 0.0
        if self.holds and place is not None:  # as assumed: a leak may look like mass
            p = with_held(p, self.body, place)
            mass_error = self.body.mass * expm1(self.errors.mass_error)
        if not self._is_known(t) or (self.holds and place is None):
            self.valves.forget()
        elif self.valves.is_due(t / SECOND):
            self.valves.look(p, Moment(self._sample(t), *self._impulses(t)), mass_error)
        found = self.valves.found
        if found == known:
            return None
        if found[:2] != known[:2]:
            self.inputs.fail(found)
            self.caught = self.found = None  # the faulty valve may have been mistaken for mass
            self._weigh()
        return found

    def _is_known(self, t: int) -> bool:
        """Return True if momentum is known at t [ns]; after a gap, the stored samples are reset."""
        if not self.base.events or self.base.lost(t) or not self.inputs.heard_at(t):
            return False
        if t > self._given_until + GAP:
            self._given_until, self.caught = t - BEFORE, None
            self._seen.clear()
            self.valves.forget()
        return True

    def _impulses(self, t: int) -> Floats:
        """Return the impulse of each valve until t [ns], about the world's origin, (2, 8, 3).

        The first row is for the commanded on-times, the second for valves that are always open.
        """
        base = self.base.state()

        def given(begin: int, end: int) -> Floats:
            x, y, heading = base.at((begin + end) // 2).pose.tolist()
            fx, fy, torque = self.inputs.valves.T
            force = (fx + 1j * fy) * np.exp(1j * heading)
            each = np.stack([force.real, force.imag, torque + x * force.imag - y * force.real], -1)
            lasts = self.inputs.open_times(begin, end), np.full(COUNT, (end - begin) / SECOND)
            found: Floats = np.stack(lasts)[:, :, None] * each
            return found

        until = max(t - BEFORE, self._given_until)  # later commands may still arrive
        self._given = self._given + given(self._given_until, until)
        self._given_until = until
        return self._given + given(until, t)

    def _sample(self, t: int) -> Sample:
        """Return the state of base and arm at t [ns], with the impulse of the valves."""
        q, qd = self._state(t)
        return Sample(
            t / SECOND, q, qd, self.base.state().covariance[3:, 3:], self.inputs.loose(),
            self._impulses(t)[0].sum(axis=0),
        )  # fmt: skip

    def _begin(self, t: int, sample: Sample) -> Caught:
        """Start the estimate of the held body from the samples before the grip.

        There are no samples of a payload before its grip. If base or joints were unknown for a
        while,
        the last estimate is the prior.
        """
        known = [seen for seen in self._seen if seen[0] <= self._gripped - BEFORE]
        self._seen.clear()
        place, state = self.place, known[-1][2] if known else None
        earlier = [seen[1] for seen in known[:: -round(SPACING * SECOND / BEFORE)]][::-1]
        if place is None:  # the target has no markers
            x, y, heading = self.body.fixture
            out = np.exp(-1j * heading) * complex(x, y)  # from it to the tip, seen from the tip
            place = hold(self.p, sample.q, tip_pose(self.p, sample.q))
            place = place + np.array([out.real, out.imag, 0.0])
        if state is None:
            tip, J = tip_pose(self.p, sample.q), tip_jacobian(self.p, sample.q)
            free = FreeBody(tip, J @ sample.qd, np.eye(3))
        else:
            free = FreeBody.of(self.p, place, state.pose, state.twist, state.covariance[3:, 3:])
        prior = self.found or MassProperties.assumed(self.body, place, self.errors)
        thrust_error = self.settings.thrust_error
        return Caught(self.p, prior, earlier or [sample], free, self.errors, thrust_error)

    def _weigh(self) -> None:
        p = self.p
        if self.found is not None:
            p = with_held(p, *self.found.held)
        elif self.place is not None:
            p = with_held(p, self.body, self.place)
        self.inputs.describe(p)

    def _state(self, t: int) -> tuple[Floats, Floats]:
        """Return the state of base and joints at t [ns], and its rate, (3 + n,) each."""
        base = self.base.state().at(t)
        q, qd = self.inputs.joints_at(t)
        return np.concatenate([base.pose, q]), np.concatenate([base.twist, qd])

    def _other(self, name: str, t: int, pose: Pose, within: float) -> str:
        """Return the name of the other body at a pose; empty if there is none."""
        other = self.target if name == "target" else self.base
        if other.events and other.distance(t, pose) <= GATE:
            x, y = other.state().at(t).pose[:2].tolist()
            if hypot(pose[0] - x, pose[1] - y) < within:
                return name
        if self.base.events and self.inputs.heard:
            x, y, heading = tip_pose(self.p, self._state(t)[0]).tolist()
            turned = wrap(pose[2] - heading)
            if hypot(pose[0] - x, pose[1] - y) < min(SAME[0], within) and abs(turned) < SAME[1]:
                return "end effector"
        return ""
