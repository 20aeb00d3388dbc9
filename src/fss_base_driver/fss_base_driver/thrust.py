"""Estimation of a valve's thrust from the base's motion before and after one pulse.

Base and arm, with joints held, are one rigid body of mass M and inertia I about its centre of mass,
which is at c in the base's frame. A pulse from t = 0 to T adds to the motion of the centre of mass
along each axis, and in the same way to the heading:

    x(t) = x_0 + v_0 t + a t^2 / 2 + dv s(t),   s(t) = 0, t^2 / 2T, t - T/2   before, in, after it

where a is the acceleration by other forces (a tilted table, a hose). The gyro measures the
heading's rate with a bias of its own. Least squares give dv and domega. Force and torque about the
base's origin, in its axes, are

    F = M R(-theta) dv / T,   tau = I domega / T + c x F
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.estimation.least_squares import Decomposition

MIN_POSES = 20  # least number of poses before a pulse, and after it


class TrackError(ValueError):
    """Failure because a track is too short; the message says what is missing."""


class Body(NamedTuple):
    """Rigid body of base and arm, joints held."""

    mass: float  # [kg]
    inertia: float  # about its centre of mass [kg m^2]
    com: tuple[float, float]  # in the base's frame [m]

    @classmethod
    def of(cls, arm: Arm, q: npt.ArrayLike) -> "Body":
        """Return the body with the arm at joint angles q, (n) [rad]."""
        H = inertia_matrix(arm.vector(), np.concatenate([np.zeros(3), np.asarray(q, float)]))
        mass = float(H[0, 0])
        x, y = float(H[1, 2]) / mass, -float(H[0, 2]) / mass
        return cls(mass, float(H[2, 2]) - mass * (x * x + y * y), (x, y))


@dataclass(frozen=True)
class Thrust:
    """Mean force and torque of a valve while it was open."""

    force: tuple[float, float]  # along the base's axes [N]
    torque: float  # about the base's origin [N m]
    deviation: tuple[float, float]  # of each force, and of the torque, 1 sigma [N, N m]

    @property
    def size(self) -> float:
        """Magnitude of the force [N]."""
        return float(np.hypot(*self.force))


def estimate(
    body: Body, poses: npt.ArrayLike, rates: npt.ArrayLike, begin: float, duration: float
) -> Thrust:
    """Estimate the thrust that acted on the base for `duration` from `begin` on [s].

    Args:
        body: base and arm.
        poses: (k, 4) time [s], x, y [m], heading [rad, without jumps] of the base.
        rates: (m, 2) time [s] and turn rate by the gyro [rad/s]; m may be 0.
        begin: of the pulse [s].
        duration: of the pulse [s].

    Raises:
        TrackError: there are not enough poses before, or after, the pulse.
    """
    track, gyro = np.asarray(poses, float).reshape(-1, 4), np.asarray(rates, float).reshape(-1, 2)
    t, heading = track[:, 0] - begin, track[:, 3]
    before, after = int((t < 0.0).sum()), int((t > duration).sum())
    if min(before, after) < MIN_POSES:
        raise TrackError(
            f"{before} poses before the pulse and {after} after it, expected {MIN_POSES} each"
        )
    turn = np.exp(1j * heading)
    com = track[:, 1] + 1j * track[:, 2] + turn * complex(*body.com)
    design = np.column_stack([np.ones_like(t), t, 0.5 * t * t, _gained(t, duration)])
    push, spread = zip(*(_fit(design, axis) for axis in (com.real, com.imag)), strict=True)
    omega, blur = _turned(design, heading, gyro[:, 0] - begin, gyro[:, 1], duration)
    middle = turn[np.abs(t - 0.5 * duration).argmin()]
    force = body.mass * complex(*push) / duration / middle
    offset = complex(*body.com).conjugate() * force  # the imaginary part is c x F
    of_force = body.mass * float(np.hypot(*spread)) / duration / np.sqrt(2.0)
    of_torque = np.hypot(body.inertia * blur / duration, abs(complex(*body.com)) * of_force)
    return Thrust(
        (float(force.real), float(force.imag)),
        float(body.inertia * omega / duration + offset.imag),
        (float(of_force), float(of_torque)),
    )


def _gained(t: Floats, duration: float) -> Floats:
    """Return s(t) [s]."""
    inside = np.clip(t, 0.0, duration)
    return 0.5 * inside * inside / duration + np.maximum(t - duration, 0.0)


def _fit(design: Floats, y: Floats) -> tuple[float, float]:
    """Return the last coefficient and its standard deviation, from the scatter about the fit."""
    basis = Decomposition.of(design)
    solution = basis.step(y)
    left = y - design @ solution
    variance = left @ left / (len(y) - design.shape[1])
    return float(solution[-1]), float(np.sqrt(variance * basis.covariance()[-1, -1]))


def _turned(
    design: Floats, heading: Floats, t: Floats, rate: Floats, duration: float
) -> tuple[float, float]:
    """Return the change of the turn rate and its deviation [rad/s], from heading and gyro."""
    results = [_fit(design, heading)]
    if len(t) >= MIN_POSES:
        ramp = np.clip(t / duration, 0.0, 1.0)
        results.append(_fit(np.column_stack([np.ones_like(t), t, ramp]), rate))
    weights = [1.0 / max(deviation, 1e-12) ** 2 for _, deviation in results]
    mean = sum(w * value for w, (value, _) in zip(weights, results, strict=True)) / sum(weights)
    return mean, float(1.0 / np.sqrt(sum(weights)))


def valve_order(layout: npt.ArrayLike) -> list[int]:
    """Return all valves, from 0, in an order in which each next one leaves the base slowest."""
    rows = np.asarray(layout, float)
    rows = rows / np.maximum(np.abs(rows).max(axis=0), 1e-12)
    total, rest, done = np.zeros(3), list(range(len(rows))), []
    while rest:
        best = min(rest, key=lambda i: (round(float(np.linalg.norm(total + rows[i])), 9), i))
        rest.remove(best)
        done.append(best)
        total = total + rows[best]
    return done


def verdict(found: Thrust, layout: npt.ArrayLike, valve: int, tolerance: float = 0.2) -> str:
    """Return how a valve deviates from its layout; empty if it does not.

    Args:
        found: measured from the base's motion.
        layout: (k, 3) of the node `base`.
        valve: from 0.
        tolerance: relative tolerance of thrust and lever.
    """
    rows = np.asarray(layout, float)
    sizes = np.hypot(rows[:, 0], rows[:, 1])
    levers = np.abs(rows[:, 2]).max() / sizes.max()
    slack = 3.0 * np.array([found.deviation[0]] * 2 + [found.deviation[1]])
    if found.size < 0.2 * sizes[valve] + slack[0]:
        return f"no thrust: {found.size:.3f} N, expected {sizes[valve]:.3f} N"
    measured = np.array([*found.force, found.torque])
    scale = np.array([1.0, 1.0, 1.0 / levers])
    fits = [
        bool((np.abs(measured - row) * scale <= tolerance * size + slack * scale).all())
        for row, size in zip(rows, sizes, strict=True)
    ]
    if fits[valve]:
        return ""
    others = [i + 1 for i, fit in enumerate(fits) if fit]
    if others:
        return f"pushes as valve {others[0]} should: are their wires or hoses swapped?"
    along = rows[valve, :2] @ measured[:2] / sizes[valve]
    if abs(along - found.size) > tolerance * sizes[valve] + slack[0]:
        found_force = f"({measured[0]:.3f}, {measured[1]:.3f}) N"
        return f"pushes along {found_force}, expected {tuple(rows[valve, :2])} N"
    if abs(found.size - sizes[valve]) > tolerance * sizes[valve] + slack[0]:
        return f"thrust is {found.size:.3f} N, expected {sizes[valve]:.3f} N"
    return (
        f"torque is {found.torque:.4f} N m, expected {rows[valve, 2]:.4f} N m: is the lever right?"
    )
