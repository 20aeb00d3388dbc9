"""Trajectory of an approach: motion of the base, joints held, to the stand-off from the fixture.

Seen from the target, which drifts uniformly, and in terms of where the end effector points:

    c = s (d - k),   s = exp(i phi),   theta = phi + pi - theta_E + psi

where c is the centre of mass relative to the target's. d is the distance of an end effector that
points straight at the target (psi = 0) from the side s. k is the centre of mass seen from the end
effector, and theta_E the end effector's heading in the base. d moves it inward, phi moves it around
the target, and psi turns it. Each is a polynomial of time that starts with the present motion and
ends at rest, or in the motion whose momentum is opposite to the target's (`cancel_momentum`): then
base and target are at rest after the grip as soon as the joints are (simultaneous capture and
detumble: Virgili-Llop and Romano, Simultaneous Capture and Detumble of a Resident Space Object by a
Free-Flying Spacecraft-Manipulator System, 2019).
"""

from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import system_com
from fss_arm_model.planar import wrap

RAMP_TIME = 8.0  # in which the final motion of an approach starts, and later ends [s]
FINAL_MOTION_TIME = 2.0  # time that an approach keeps its final motion [s]
MAX_FINAL_SPEED = 0.004  # largest inward speed of the final motion [m/s]


class Points(NamedTuple):
    """Poses, twists and accelerations of the base in the world, (k, 3) each."""

    pose: Floats
    twist: Floats
    acceleration: Floats


def quintic(start: float, rate: float, end: float, duration: float, t: Floats) -> Floats:
    """Return value, rate and acceleration (3, k), from a value and a rate to rest at another."""
    T, u = duration, np.clip(t / duration, 0.0, 1.0)
    change, ramp = end - start, rate * T
    a, b, c = 10 * change - 6 * ramp, -15 * change + 8 * ramp, 6 * change - 3 * ramp
    value = start + u * (ramp + u * u * (a + u * (b + u * c)))
    first = (ramp + u * u * (3 * a + u * (4 * b + u * 5 * c))) / T
    second = u * (6 * a + u * (12 * b + u * 20 * c)) / T**2
    return np.stack([value, first, second])


def ramp(since_end: Floats) -> Floats:
    """Return distance, rate and acceleration (3, k) of a motion that rises to the rate 1.

    It starts RAMP_TIME before the end, keeps the rate for FINAL_MOTION_TIME after it, then stops.
    """

    def rise(t: Floats) -> Floats:
        u = np.clip(t / RAMP_TIME, 0.0, 1.0)
        distance = RAMP_TIME * u**3 * (1.0 - 0.5 * u) + np.maximum(t - RAMP_TIME, 0.0)
        return np.stack([distance, u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / RAMP_TIME])

    return rise(since_end + RAMP_TIME) - rise(since_end - FINAL_MOTION_TIME)


class RigidCraft:
    """Base and arm with joints held: centre of mass, and pointing direction of the end effector."""

    def __init__(self, p: Floats, q_m: npt.ArrayLike) -> None:
        self.p, self.q_m = p, np.array(q_m, dtype=float)
        x, y, self.tip_heading = (float(v) for v in tip_in_base(p, self.q_m))
        q = np.concatenate([np.zeros(3), self.q_m])
        self.com = complex(*system_com(p, q))
        self.k = (self.com - complex(x, y)) * np.exp(-1j * self.tip_heading)
        H = inertia_matrix(p, q)
        self.mass = float(H[0, 0])
        self.inertia = float(H[2, 2]) - self.mass * abs(self.com) ** 2  # about the centre of mass

    def polar(self, pose: Floats, twist: Floats) -> tuple[Floats, Floats] | None:
        """Return d, phi, psi and their rates from the base's pose and twist relative to the target.

        None if the centre of mass is too close to the target.
        """
        com_offset = np.exp(1j * pose[2]) * self.com
        c = complex(*pose[:2]) + com_offset
        v = complex(*twist[:2]) + 1j * twist[2] * com_offset
        square = abs(c) ** 2 - self.k.imag**2
        if square <= 0.0:
            return None
        d = self.k.real + np.sqrt(square)
        s = c / (d - self.k)
        psi = wrap(pose[2] - (np.angle(s) + pi - self.tip_heading))
        return np.array([d, np.angle(s), psi]), self._polar_rates(d, v / s, twist[2])

    def _polar_rates(self, d: float, linear: complex, omega: float) -> Floats:
        """Return the rates of d, phi, psi, from the velocity of the centre of mass over s."""
        phi_rate = linear.imag / (d - self.k.real)
        outward = linear.real - phi_rate * self.k.imag
        return np.array([outward, phi_rate, omega - phi_rate])

    def canceling_rates(self, d: float, phi: float, target: Target, state: Floats) -> Floats:
        """Return the rates of d, phi, psi with a momentum opposite to the target's.

        The angular momentum about the common centre of mass vanishes. The linear one does so, too,
        unless the inward speed were above MAX_FINAL_SPEED.

        Args:
            d: distance of the end effector [m].
            phi: direction of the side [rad].
            target: with its mass and inertia.
            state: (2, 3) its pose and twist.
        """
        drift = complex(*state[1, :2]) * np.exp(-1j * phi)
        linear = -drift * (1.0 + target.mass / self.mass)
        rates = self._polar_rates(d, linear, 0.0)
        if rates[0] < -MAX_FINAL_SPEED:
            linear -= rates[0] + MAX_FINAL_SPEED
        reduced = self.mass * target.mass / (self.mass + target.mass)
        orbital = reduced * (np.conj(d - self.k) * linear).imag  # angular momentum of both masses
        omega = -(target.inertia * float(state[1, 2]) + orbital) / self.inertia
        return self._polar_rates(d, linear, omega)

    def points(self, d: Floats, phi: Floats, psi: Floats) -> Points:
        """Return the base's motion seen from the target.

        Args:
            d: (3, k) value, rate and acceleration [m].
            phi: (3, k) the same of the side's direction [rad].
            psi: (3, k) the same of the turn [rad].
        """
        s, arm = np.exp(1j * phi[0]), d[0] - self.k
        v = s * (d[1] + 1j * phi[1] * arm)
        a = s * (d[2] + 2j * phi[1] * d[1] + (1j * phi[2] - phi[1] ** 2) * arm)
        heading = phi[0] + pi - self.tip_heading + psi[0]
        omega, alpha = phi[1] + psi[1], phi[2] + psi[2]
        w = self.com * np.exp(1j * heading)
        return Points(
            _rows(s * arm - w, heading),
            _rows(v - 1j * omega * w, omega),
            _rows(a - (1j * alpha - omega**2) * w, alpha),
        )


def _rows(linear: Complexes, turning: Floats) -> Floats:
    return np.stack([linear.real, linear.imag, turning], axis=-1)


class Timing(NamedTuple):
    """Timing of the motions inward and around the target, as shares of the duration."""

    turn_interval: tuple[float, float]  # start and end of the change of phi
    detour_end: float = 0.0  # end of a first motion of d to another distance
    detour_distance: float | None = None  # that distance [m]; None: straight in


@dataclass(frozen=True)
class ApproachTrajectory:
    """Trajectory from the start to the stand-off, in the target's drifting frame."""

    body: RigidCraft
    start: Floats  # (3,) d, phi, psi
    start_rate: Floats  # (3,)
    end: Floats  # (3,)
    duration: float  # [s]
    timing: Timing
    side: float  # direction in which the fixture is awaited [rad]
    final_rate: Floats  # (3,) at the end

    def points(self, t: npt.ArrayLike) -> Points:
        """Return the points at times since the start [s], seen from the target."""
        t, T, timing = np.atleast_1d(np.asarray(t, dtype=float)), self.duration, self.timing
        start, speed = self.start.tolist(), self.start_rate.tolist()
        end = (self.end - 0.5 * RAMP_TIME * self.final_rate).tolist()  # without the final motion
        d = quintic(start[0], speed[0], end[0], T, t)
        if timing.detour_distance is not None:
            half, detour_distance = timing.detour_end * T, timing.detour_distance
            outward = quintic(start[0], speed[0], detour_distance, half, t)
            back = quintic(detour_distance, 0.0, end[0], T - half, np.maximum(t - half, 0.0))
            d = np.where(t > half, back, outward)
        since, until = timing.turn_interval[0] * T, timing.turn_interval[1] * T
        rate = 0.0 if since else speed[1]
        phi = quintic(start[1], rate, end[1], until - since, np.maximum(t - since, 0.0))
        psi = quintic(start[2], speed[2], end[2], min(until, 0.6 * T), t)
        final = ramp(t - T)
        d, phi, psi = (
            a + rate * final for a, rate in zip((d, phi, psi), self.final_rate, strict=True)
        )
        return self.body.points(d, phi, psi)


def propagate_coast(pose: Floats, twist: Floats, com: complex, time: float | Floats) -> Floats:
    """Return poses (..., 3) of the base a time later [s], base and arm moving as one free body."""
    w = com * np.exp(1j * pose[..., 2])
    v = twist[..., 0] + 1j * twist[..., 1] + 1j * twist[..., 2] * w
    heading = pose[..., 2] + time * twist[..., 2]
    origin = pose[..., 0] + 1j * pose[..., 1] + w + time * v - com * np.exp(1j * heading)
    return np.stack([origin.real, origin.imag, heading], axis=-1)
