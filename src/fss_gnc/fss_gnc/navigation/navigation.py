"""Base and target together, as one may be taken for the other, and one may hold the other."""

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
SAME = 0.05, 0.15  # a pose so near to the end effector's is the end effector's [m], [rad]
UNSEEN = SECOND // 5  # a held target that is not seen for so long is where the gripper has it
GRIP = 0.05, 0.1  # by how much gripping and letting go changes twists [m/s], [rad/s]
SHAKEN = 0.05, 0.2  # random walk of a held target's twist [m/s/sqrt(s)], [rad/s/sqrt(s)]
BEFORE = SECOND // 2  # so long before a grip is heard of, none had been; and after, all is calm
EARLIER = 20  # moments before a grip that are kept, BEFORE apart
GAP = 2 * SECOND  # in which nothing was known; what the valves gave meanwhile is not either
EASED = 0.05  # of what a pose of the held target says of its place in the gripper is believed


class _Carried(Free):
    """Inputs of the target, which the arm accelerates while the gripper holds it."""

    def __init__(self, errors: TargetErrors) -> None:
        super().__init__(errors)
        self.held = False
        shaken = np.diag(np.square([SHAKEN[0], SHAKEN[0], SHAKEN[1]]))
        self._shaken = np.zeros((1, 3)), shaken[None]

    def over(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """No known acceleration; the noise is larger while the target is held."""
        return self._shaken if self.held else super().over(times)


class Navigation:
    """The filters of base and target.

    A rejected pose at which another body is known to be is reported under its name and not used, as
    when motion capture swaps base and target.

    Args:
        arm: its description.
        settings: errors of sensors and inputs.
        of_target: errors of the target's poses, and its process noise.
        body: assumed mass and inertia of the target.
        errors: how well these are known, and what else changes the momentum.
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
        self.place: Floats | None = None  # of the target in the gripper; None: it is not held
        self.errors = errors or CaughtErrors()
        self.caught: Caught | None = None
        self.found: MassProperties | None = None  # of what is held; None: nothing measured yet
        self._gripped = 0  # when that was heard [ns]
        self._seen: deque[tuple[int, Sample, BodyState | None]] = deque(maxlen=EARLIER)
        self.valves = ValveFaults(self.settings.thrust_error)
        # Impulses of each valve, as told and had it been open, and until when [ns].
        self._given, self._given_until = np.zeros((2, COUNT, 3)), -GAP

    @property
    def holds(self) -> bool:
        """Whether the gripper holds the target."""
        return self._carried.held

    def describe(self, arm: Arm) -> None:
        """Use a new description of the arm, as after a calibration."""
        self.p = arm.vector()
        if self.caught:
            self.caught.p = self.p
        self._weigh()

    def joint(self, i: int, t: int, q: float, qd: float) -> None:
        """Take a reading q [rad], qd [rad/s] of joint i, from 0, at t [ns]."""
        omega = self.base.state().twist[2] if self.base.events else 0.0
        since = self.inputs.joint(i, t, q, qd, float(omega))
        if since is not None:
            self.base.revise(since)

    def pulses(self, t: int, on_times: npt.ArrayLike) -> bool:
        """Take on-times (8,) [s] that were sent to the valves at t [ns]; False: ignored."""
        taken = self.inputs.pulses(t, on_times)
        if taken:
            self.base.revise(t)
        return taken

    def confused(self, t: int) -> list[tuple[str, str]]:
        """Pairs of bodies (name, other): within the last second one was seen where the other is."""
        bodies = ("base", self.base), ("target", self.target)
        return [
            (name, body.confused[1])
            for name, body in bodies
            if body.confused and t - body.confused[0] < SECOND
        ]

    def target_pose(self, t: int, x: float, y: float, heading: float) -> bool:
        """Update with a pose [m, m, rad] of the target seen at t [ns]; whether it was accepted."""
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
        """Take what the gripper says: whether it holds the target."""
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
        """Estimate the mass properties of what is held at t [ns]; None unless they are new."""
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
        if not self.caught.explained:  # by any mass: what was found before stays
            return None
        self.found = found
        self._weigh()
        return self.found

    def diagnose(self, t: int) -> Faults | None:
        """Look for faulty valves at t [ns]; None unless what is found has changed."""
        known, place = self.valves.found, self.place
        p, mass_error = self.p, 0.0
        if self.holds and place is not None:  # as assumed: a leak may have passed for mass
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
            self.caught = self.found = None  # what the valve did may have passed for mass
            self._weigh()
        return found

    def _is_known(self, t: int) -> bool:
        """Whether momentum is known at t [ns]; after a gap in which it was not, all restarts."""
        if not self.base.events or self.base.lost(t) or not self.inputs.heard_at(t):
            return False
        if t > self._given_until + GAP:
            self._given_until, self.caught = t - BEFORE, None
            self._seen.clear()
            self.valves.forget()
        return True

    def _impulses(self, t: int) -> Floats:
        """Of each valve until t [ns], about the world's origin, as told and if open, (2, 8, 3)."""
        base = self.base.state()

        def given(begin: int, end: int) -> Floats:
            x, y, heading = base.at((begin + end) // 2).pose.tolist()
            fx, fy, torque = self.inputs.valves.T
            force = (fx + 1j * fy) * np.exp(1j * heading)
            each = np.stack([force.real, force.imag, torque + x * force.imag - y * force.real], -1)
            lasts = self.inputs.open_times(begin, end), np.full(COUNT, (end - begin) / SECOND)
            found: Floats = np.stack(lasts)[:, :, None] * each
            return found

        until = max(t - BEFORE, self._given_until)  # of what came later not all may be heard yet
        self._given = self._given + given(self._given_until, until)
        self._given_until = until
        return self._given + given(until, t)

    def _sample(self, t: int) -> Sample:
        """All as it is at t [ns], with what the valves have given."""
        q, qd = self._state(t)
        return Sample(
            t / SECOND, q, qd, self.base.state().covariance[3:, 3:], self.inputs.loose(),
            self._impulses(t)[0].sum(axis=0),
        )  # fmt: skip

    def _begin(self, t: int, sample: Sample) -> Caught:
        """With what was known before the grip; of a payload nothing was.

        Where base or joints were not known for a while, what was found until then is the prior.
        """
        known = [seen for seen in self._seen if seen[0] <= self._gripped - BEFORE]
        self._seen.clear()
        place, state = self.place, known[-1][2] if known else None
        earlier = [seen[1] for seen in known[:: -round(SPACING * SECOND / BEFORE)]][::-1]
        if place is None:  # it has no markers
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
        """Base and joints at t [ns], and their rates, (3 + n,) each."""
        base = self.base.state().at(t)
        q, qd = self.inputs.joints_at(t)
        return np.concatenate([base.pose, q]), np.concatenate([base.twist, qd])

    def _other(self, name: str, t: int, pose: Pose, within: float) -> str:
        """The name of who else is at a pose."""
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
