"""A second, passive spacecraft simulator on the table, and the gripper that can hold it.

While it is held, the target is part of the last link. At the capture the gripper closes at once,
plastically: an impulse between end effector and target makes their velocities alike, so that
momentum stays and energy is lost. With the target's centre of mass at J_t qd,

    (H + J_t' M_t J_t) qd_after = H qd_before + J_t' M_t v_t
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from fss_arm_model import layout
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_model.settings import FINITE, NOT_NEGATIVE, POSITIVE, Settings, setting

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Target(Settings):
    """The target as a body; its frame's origin is its centre of mass."""

    mass: float = setting(10.0, "mass of the target", unit="kg", check=POSITIVE)
    inertia: float = setting(
        0.25, "inertia of the target about its centre of mass", unit="kg m^2", check=POSITIVE
    )
    fixture: tuple[float, ...] = setting(
        (0.19, 0.0, 0.0), "place to grip the target at, in its frame: x, y, outward heading",
        unit="m, m, rad", check=FINITE, size=3,
    )  # fmt: skip

    def vector(self) -> Floats:
        """As a base without an arm, for the kernel: (8,)."""
        p = np.zeros(layout.BASE_SIZE)
        p[layout.MASS], p[layout.INERTIA] = self.mass, self.inertia
        return p


@dataclass(frozen=True)
class Gripper(Settings):
    """How near, straight and slow the end effector must be to grip."""

    reach: float = setting(
        0.03, "largest distance of the gripper from what it grips", unit="m", check=NOT_NEGATIVE
    )
    angle: float = setting(
        0.5, "largest angle of the gripper against what it grips", unit="rad", check=NOT_NEGATIVE
    )
    speed: float = setting(
        0.1, "largest speed of what is gripped past the gripper", unit="m/s", check=NOT_NEGATIVE
    )


@dataclass(frozen=True)
class Approach:
    """The end effector as seen from the fixture."""

    distance: float  # [m]
    angle: float  # [rad], 0: straight into the fixture
    speed: float  # [m/s]

    def within(self, gripper: Gripper) -> bool:
        """Whether the gripper can close."""
        return (
            self.distance <= gripper.reach
            and abs(self.angle) <= gripper.angle
            and self.speed <= gripper.speed
        )


def approach(p: Floats, q: Floats, qd: Floats, target: Target, state: Floats) -> Approach:
    """Of the arm p in the state q, qd to the target at `state`, (2, 3) pose and twist."""
    x, y, heading = tip_pose(p, q)
    vx, vy, _ = tip_jacobian(p, q) @ qd
    out = complex(*target.fixture[:2]) * np.exp(1j * state[0, 2])
    apart = complex(*state[0, :2]) + out - complex(x, y)
    moving = complex(*state[1, :2]) + 1j * state[1, 2] * out - complex(vx, vy)
    angle = heading - (state[0, 2] + target.fixture[2] + pi)
    return Approach(abs(apart), float((angle + pi) % (2.0 * pi) - pi), abs(moving))


def hold(p: Floats, q: Floats, pose: npt.ArrayLike) -> Floats:
    """The pose of a body in the frame of the last link: x, y [m], heading [rad]."""
    x, y, heading = tip_pose(p, q)
    heading -= p[layout.TIP_ANGLE]
    body_x, body_y, body_heading = np.asarray(pose)
    apart = (complex(body_x, body_y) - complex(x, y)) * np.exp(-1j * heading)
    return np.array([apart.real + _length(p), apart.imag, body_heading - heading])


def held(p: Floats, q: Floats, qd: Floats, place: Floats) -> Floats:
    """Pose and twist (2, 3) of a body held at `place` in the frame of the last link."""
    x, y, heading = tip_pose(p, q)
    heading -= p[layout.TIP_ANGLE]
    apart = complex(place[0] - _length(p), place[1]) * np.exp(1j * heading)
    twist = held_jacobian(p, q, place) @ qd
    return np.array([[x + apart.real, y + apart.imag, heading + place[2]], twist])


def held_jacobian(p: Floats, q: Floats, place: Floats) -> Floats:
    """(3, 3 + n): the twist of a body held at `place`, by qd."""
    J = tip_jacobian(p, q)
    heading = tip_pose(p, q)[2] - p[layout.TIP_ANGLE]
    apart = complex(place[0] - _length(p), place[1]) * np.exp(1j * heading)
    J[0] -= apart.imag * J[2]
    J[1] += apart.real * J[2]
    return J


def with_held(p: Floats, target: Target, place: Floats) -> Floats:
    """The arm's parameters with the target at `place` made part of the last link."""
    n = layout.count(p)
    mass, moment, at = layout.mass(p, n), layout.inertia(p, n), layout.com(p, n)
    body = complex(place[0], place[1])
    whole = mass + target.mass
    middle = (mass * at + target.mass * body) / whole
    moment += target.inertia + mass * abs(at - middle) ** 2 + target.mass * abs(body - middle) ** 2
    p = p.copy()
    link = p[layout.LINK_SIZE * n :]
    link[layout.LINK_MASS], link[layout.LINK_INERTIA] = whole, moment
    link[layout.G], link[layout.LATERAL] = middle.real, middle.imag
    return p


def _length(p: Floats) -> float:
    """Of the last link [m]."""
    return float(layout.each(p, layout.LENGTH)[-1])


def caught(
    p: Floats, q: Floats, qd: Floats, rotor: tuple[float, float], target: Target, state: Floats
) -> Floats:
    """Velocity of the arm right after it has gripped the target at state (2, 3)."""
    H = inertia_matrix(p, q) + rotors_inertia(q.size, rotor)
    J = held_jacobian(p, q, hold(p, q, state[0]))
    M = np.array([target.mass, target.mass, target.inertia])
    gained = J.T @ (M * (state[1] - J @ qd))
    return qd + np.linalg.solve(H + J.T @ (M[:, None] * J), gained)


def rotors_inertia(size: int, rotor: tuple[float, float]) -> Floats:
    """What rotors add to H: N^2 J at their joint, N J between it and all that turns its stator."""
    H = np.zeros((size, size))
    for k in range(3, size):
        H[k, k] = rotor[0]
        H[k, 2:k] = H[2:k, k] = rotor[1]
    return H
