"""Model of a second, passive spacecraft simulator on the table, and of the gripper that holds it.

While it is held, the target is part of the last link. When the fingers close, an impulse between
end effector and target makes their velocities equal. This conserves momentum and loses energy.
With the velocity J_t qd of the held target's centre of mass,

    (H + J_t' M_t J_t) qd_after = H qd_before + J_t' M_t v_t

A gripper with limits slides on the target, as by Coulomb friction, while it would have to transmit
more. It then transmits the load that would hold the target, scaled down to the limits.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.held import Approach, Target, payload_jacobian, payload_pose
from fss_arm_model.settings import NOT_NEGATIVE, Settings, setting
from fss_sim.plant.chain import GEARS, ROTOR, VALVES
from fss_sim.plant.contact import Part
from fss_sim.plant.simulation import EMPTY_SCENE, advance
from fss_sim.plant.surroundings import Surroundings

DWELL = 100  # steps at rest after which another slide counts as another slip


@dataclass(frozen=True)
class Gripper(Settings):
    """Limits of the gripper: distance, angle and speed for a grip, and the load that it holds."""

    reach: float = setting(
        0.03, "largest distance from gripper to fixture for a grip", unit="m", check=NOT_NEGATIVE
    )
    angle: float = setting(
        0.5,
        "largest angle between gripper and fixture for a grip",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    speed: float = setting(
        0.1,
        "largest speed of the fixture relative to the gripper for a grip",
        unit="m/s",
        check=NOT_NEGATIVE,
    )

    length: float = setting(
        0.15, "length of the gripper, the end of the last link", unit="m", check=NOT_NEGATIVE
    )
    closing_time: float = setting(
        0.0, "time that the gripper's fingers take to close", unit="s", check=NOT_NEGATIVE
    )
    force: float = setting(
        0.0, "force at which a grip slides; 0: no limit", unit="N", check=NOT_NEGATIVE
    )
    torque: float = setting(
        0.0, "torque at which a grip slides; 0: no limit", unit="N m", check=NOT_NEGATIVE
    )

    @property
    def limited(self) -> bool:
        """Return True if force or torque can overload the grip."""
        return self.force > 0.0 or self.torque > 0.0

    def can_grip(self, approach: Approach) -> bool:
        """Return True if the gripper can close on a fixture seen at this approach."""
        return self.encloses(approach) and approach.speed <= self.speed

    def encloses(self, approach: Approach) -> bool:
        """Return True if a fixture seen at this approach is between the fingers."""
        return approach.distance <= self.reach and abs(approach.angle) <= self.angle


class Load(NamedTuple):
    """Load on a grip."""

    force: complex = 0j  # on the thing held, x + i y in world axes [N]
    torque: float = 0.0  # about the tip [N m]

    def share(self, gripper: Gripper) -> float:
        """Return the load as a share of what the gripper holds."""
        force = abs(self.force) / gripper.force if gripper.force else 0.0
        return max(force, abs(self.torque) / gripper.torque if gripper.torque else 0.0)

    def scaled(self, factor: float) -> "Load":
        """Return a multiple of the load."""
        return Load(factor * self.force, factor * self.torque)


@dataclass
class Fingers:
    """State of a gripper that is commanded to close: waiting, closing, or closed."""

    closing_since: int | None = None  # step at which the fingers started to close
    missed: bool = False  # True if they closed on nothing or lost the thing: they must open first
    slides: bool = False  # True while the thing held slides between them
    last_slide: int = 0  # step in which it slid last
    slips: int = 0  # number of slides of a thing that they had held at rest for DWELL
    losses: int = 0  # number of things that slid out of them
    force: float = 0.0  # largest force on the thing in the last advance; 0 without limits [N]
    torque: float = 0.0  # largest torque on it [N m]

    def add_load(self, load: Load, slides: bool, step: int) -> None:
        """Update largest force and torque, and whether the thing slides, in a step."""
        self.force = max(self.force, abs(load.force))
        self.torque = max(self.torque, abs(load.torque))
        self.slides = slides
        if slides:
            self.slips += step > self.last_slide + DWELL
            self.last_slide = step


class PassiveTarget:
    """Target that floats freely or is held by a gripper.

    Args:
        target: parameters of the target.
        state: (2, 3) initial pose and twist.
        around: forces on it from outside.
        name: name in clearances and contacts.
    """

    n = 0  # joints

    def __init__(
        self,
        target: Target,
        state: npt.ArrayLike,
        around: Surroundings | None = None,
        name: str = "target",
    ) -> None:
        self.target, self.name = target, name
        self._attached_state: Callable[[], Floats] | None = None  # None: it floats freely
        self.masses = np.array([target.mass, target.mass, target.inertia])
        around = around or Surroundings()
        radius = max(target.radius, 1e-9)
        around = replace(around, tether=0.0, tether_twist=0.0, base_radius=radius)
        self.p = target.vector()
        none = np.zeros(ROTOR + GEARS), around.vector(), np.zeros(VALVES)
        self._constants = np.concatenate([self.p, *none])
        self.snapshot = np.append(np.asarray(state, dtype=float), np.zeros(8))

    @property
    def state(self) -> Floats:
        """Pose and twist in the world frame, (2, 3)."""
        return self._attached_state() if self._attached_state else self._state

    @property
    def is_free(self) -> bool:
        """Return True if the target is not part of a vehicle's last link."""
        return self._attached_state is None

    @property
    def q(self) -> Floats:
        """Pose (3,)."""
        return self.state[0]

    @property
    def qd(self) -> Floats:
        """Twist (3,)."""
        return self.state[1]

    @property
    def snapshot(self) -> Floats:
        """State that a step changes (simulation.py)."""
        return self._snapshot

    @snapshot.setter
    def snapshot(self, snapshot: Floats) -> None:
        self._snapshot = snapshot
        self._state, self.audit_rows = snapshot[:6].reshape(2, 3), snapshot[6:].reshape(2, 4)

    def parts(self) -> list[Part]:
        """Return the parts of the target that can touch others."""
        return [Part(self.name, 0, 0j, 0j, self.target.radius)]

    def inertia(self) -> Floats:
        """Return the inertia that an impulse acts on, (3, 3)."""
        return np.diag(self.masses)

    def add_velocity(self, change: Floats) -> None:
        """Add an instantaneous change to the twist."""
        self.snapshot = self._snapshot.copy()
        self._state[1] += change

    def constants(self, _: int) -> Floats:
        """Return the constants of its steps, as of a base without arm and thrusters."""
        return self._constants

    def update_audit(self) -> None:
        """Update the audit of momentum and energy after a change of the state."""
        advance([self], EMPTY_SCENE, 0, 0)

    def attach(self, state: Callable[[], Floats]) -> None:
        """Let the target move with a vehicle's last link: `state` returns its pose and twist."""
        self._attached_state = state

    def set_free(self, state: Floats) -> None:
        """Let the target float freely from this state on."""
        self._attached_state, self.snapshot = None, np.append(state, np.zeros(8))
        self.update_audit()


def velocity_after_capture(
    p: Floats, q: Floats, qd: Floats, H: Floats, body: PassiveTarget
) -> Floats:
    """Return the velocity of the arm of inertia H immediately after it has gripped the target."""
    J = payload_jacobian(p, q, payload_pose(p, q, body.q))
    gained = J.T @ (body.masses * (body.qd - J @ qd))
    return qd + np.linalg.solve(H + J.T @ (body.masses[:, None] * J), gained)


def rotors_inertia(size: int, rotor: tuple[float, float], flexible: bool) -> Floats:
    """Return the rotors' contribution to H, for an impulse on the links.

    A rotor adds N^2 J at its joint, and N J between this joint and all coordinates that turn its
    stator. A free rotor behind a flexible gear adds nothing. Its J, which is part of the inertia of
    the stator's link, is subtracted.
    """
    H = np.zeros((size, size))
    for k in range(3, size):
        if flexible and rotor[0]:
            H[2:k, 2:k] -= rotor[1] * rotor[1] / rotor[0]
        elif not flexible:
            H[k, k] += rotor[0]
            H[k, 2:k] += rotor[1]
            H[2:k, k] += rotor[1]
    return H
