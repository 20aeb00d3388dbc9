"""A body in the gripper as part of the last link, and the approach of the end effector to it.

In all functions p (8 + 6 n,) is Arm.vector(), q and qd (3 + n,) the state and its rate, and place
(3,) the pose of the held body in the frame of the last link: x, y [m], heading [rad]. The origin of
that frame is the last joint, its x axis points to the tip. The notation is that of kinematics.py:
vectors are complex numbers.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from . import layout
from .arrays import Floats
from .dynamics import inertia_matrix
from .kernels import kernel
from .kinematics import SIZE_TWO, tip_jacobian, tip_pose, write_chain
from .momentum import momentum, system_com
from .planar import wrap
from .settings import FINITE, NOT_NEGATIVE, POSITIVE, Settings, setting


@dataclass(frozen=True)
class Target(Settings):
    """The target as a body; the origin of its frame is its centre of mass."""

    mass: float = setting(10.0, "mass of the target", unit="kg", check=POSITIVE)
    inertia: float = setting(
        0.25, "inertia of the target about its center of mass", unit="kg m^2", check=POSITIVE
    )
    fixture: tuple[float, ...] = setting(
        (0.19, 0.0, 0.0),
        "grip fixture in the target's frame: x, y, outward heading",
        unit="m, m, rad",
        check=FINITE,
        size=3,
    )
    radius: float = setting(
        0.19, "radius of the target about its center of mass", unit="m", check=NOT_NEGATIVE
    )

    def vector(self) -> Floats:
        """Return the parameters of a base without an arm for the kernels, (8,)."""
        p = np.zeros(layout.BASE_SIZE)
        p[layout.MASS], p[layout.INERTIA] = self.mass, self.inertia
        return p


class Approach(NamedTuple):
    """Position and speed of the end effector relative to the fixture."""

    distance: float  # [m]
    angle: float  # [rad], 0: straight into the fixture
    speed: float  # [m/s]


def approach(p: Floats, q: Floats, qd: Floats, target: Target, state: Floats) -> Approach:
    """Return the approach of the arm p in state q, qd to the target at `state` (2, 3)."""
    x, y, heading = tip_pose(p, q)
    vx, vy, _ = tip_jacobian(p, q) @ qd
    fixture = complex(*target.fixture[:2]) * np.exp(1j * state[0, 2])
    distance = complex(*state[0, :2]) + fixture - complex(x, y)
    velocity = complex(*state[1, :2]) + 1j * state[1, 2] * fixture - complex(vx, vy)
    angle = heading - (state[0, 2] + target.fixture[2] + math.pi)
    return Approach(abs(distance), float(wrap(angle)), abs(velocity))


def payload_pose(p: Floats, q: Floats, pose: npt.ArrayLike) -> Floats:
    """Return the place of a body at a pose in the world."""
    x, y, heading = tip_pose(p, q)
    heading -= p[layout.TIP_ANGLE]
    body_x, body_y, body_heading = np.asarray(pose)
    from_tip = (complex(body_x, body_y) - complex(x, y)) * np.exp(-1j * heading)
    return np.array([from_tip.real + _length(p), from_tip.imag, body_heading - heading])


def payload_positions(p: Floats, q: Floats, place: Floats) -> Floats:
    """Return the positions (..., 2) in the world of a body held at `place`."""
    x, y, heading = np.moveaxis(tip_pose(p, q), -1, 0)
    turn = np.exp(1j * (heading - p[layout.TIP_ANGLE]))
    from_tip = complex(place[0] - _length(p), place[1]) * turn
    return np.stack([x + from_tip.real, y + from_tip.imag], axis=-1)


@kernel("(p),(m),(m),(t),(s)->(s,t)")
def _payload_state(
    p: Floats, q: Floats, qd: Floats, place: Floats, _s: Floats, state: Floats
) -> None:
    d, e = np.empty((2, q.size - 2), np.complex128)
    heading = write_chain(p, q, d, e) - p[layout.TIP_ANGLE]
    r, v, omega = complex(q[0], q[1]), complex(qd[0], qd[1]), qd[2]
    for k in range(d.size - 1):
        r += d[k]
        v += 1j * omega * d[k]
        omega += qd[3 + k]
    arm = complex(place[0], place[1]) * complex(math.cos(heading), math.sin(heading))
    r += arm
    v += 1j * omega * arm
    state[0, 0], state[0, 1], state[0, 2] = r.real, r.imag, heading + place[2]
    state[1, 0], state[1, 1], state[1, 2] = v.real, v.imag, omega


def payload_state(p: Floats, q: Floats, qd: Floats, place: Floats) -> Floats:
    """Return pose and twist (2, 3) in the world of a body held at `place`."""
    return np.asarray(_payload_state(p, q, qd, place, SIZE_TWO))


def payload_jacobian(p: Floats, q: Floats, place: Floats) -> Floats:
    """Return the Jacobian (3, 3 + n) from qd to the twist of a body held at `place`."""
    J = tip_jacobian(p, q)
    heading = tip_pose(p, q)[2] - p[layout.TIP_ANGLE]
    from_tip = complex(place[0] - _length(p), place[1]) * np.exp(1j * heading)
    J[0] -= from_tip.imag * J[2]
    J[1] += from_tip.real * J[2]
    return J


def with_payload(p: Floats, target: Target, place: Floats) -> Floats:
    """Return the arm's parameters with the target at `place` added to the last link."""
    n = layout.count(p)
    mass, inertia, com = layout.mass(p, n), layout.inertia(p, n), layout.com(p, n)
    body = complex(place[0], place[1])
    total = mass + target.mass
    common = (mass * com + target.mass * body) / total  # centre of mass of link and body
    parallel = mass * abs(com - common) ** 2  # parallel-axis theorem
    inertia += target.inertia + parallel + target.mass * abs(body - common) ** 2
    p = p.copy()
    link = p[layout.LINK_SIZE * n :]
    link[layout.LINK_MASS], link[layout.LINK_INERTIA] = total, inertia
    link[layout.G], link[layout.LATERAL] = common.real, common.imag
    return p


def _length(p: Floats) -> float:
    """Return the length of the last link [m]."""
    return float(layout.each(p, layout.LENGTH)[-1])


def combined_momentum(
    p: Floats, q: Floats, qd: Floats, target: Target, state: npt.ArrayLike
) -> Floats:
    """Return the momentum of arm and free target at `state`, (2, 3) pose and twist.

    A grip does not change this momentum.

    Returns:
        (3,) linear, and angular about their common centre of mass [N s, N s, N m s].
    """
    (x, y, _), (vx, vy, omega) = np.asarray(state, dtype=float)
    px, py, L = momentum(p, q, qd)
    mass, M = float(inertia_matrix(p, q)[0, 0]), target.mass
    offset = complex(x, y) - complex(*system_com(p, q))
    velocity = complex(vx, vy) - complex(px, py) / mass
    orbital = mass * M / (mass + M) * (np.conj(offset) * velocity).imag  # of two point masses
    return np.array([px + M * vx, py + M * vy, L + target.inertia * omega + orbital])
