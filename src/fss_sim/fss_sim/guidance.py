"""Guidance of a rehearsal: go to a tumbling target by thrusters, grip it with the arm, stop it.

Pure: what is seen goes in every PERIOD, orders come out. The phases:

    approach  thrusters take the base, joints held, to where the end effector stands off from the
              target's fixture as it will be when it has turned to face the arm
    reach     thrusters off, so that momentum stays; the arm follows the fixture by the generalized
              Jacobian (momentum.py), with the drift that the momentum gives taken off, and the
              gripper closes on what comes within its reach
    detumble  the target held, thrusters take momentum away
    done
"""

from dataclasses import dataclass, field
from math import pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target, hold, with_held
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import generalized_jacobian, momentum, system_com

Floats = npt.NDArray[np.float64]

PERIOD = 0.2  # of the guidance [s]
ALPHA, BETA = 0.15, 0.01  # of the trackers, at VICON's rate
STAND_OFF = 0.12  # of the end effector from the fixture before it reaches for it [m]
SPEED, TURN = 0.08, 0.05  # most in the approach [m/s], [rad/s]
REACH_SPEED, REACH_TURN = 0.05, 0.15  # of the end effector past the fixture [m/s], [rad/s]
LEAD = 3.0  # the reach begins so long before the fixture faces the arm [s]
RATE = 0.4  # most of a joint [rad/s]
MOTION_THRESHOLD = 0.004, 0.004  # of the whole when it is stopped [m/s], [rad/s]


class Orders(NamedTuple):
    """What the guidance wants until the next time."""

    on_times: list[float]  # of the thrusters [s]
    rates: list[float]  # of the joints [rad/s]
    close: bool  # the gripper
    phase: str


@dataclass
class Track:
    """Pose and twist of a subject from poses alone, by an alpha-beta filter."""

    pose: Floats = field(default_factory=lambda: np.zeros(3))  # its heading unwrapped
    twist: Floats = field(default_factory=lambda: np.zeros(3))
    time: float | None = None  # of the last pose [s]; None before the first

    def update(self, time: float, pose: npt.ArrayLike) -> None:
        """Take a pose [m, m, rad] seen at a time [s]."""
        seen = np.array(pose, dtype=float)
        if self.time is None:
            self.pose, self.time = seen, time
            return
        step, self.time = time - self.time, time
        ahead = self.pose + step * self.twist
        seen[2] = ahead[2] + wrapped(seen[2] - ahead[2])
        self.pose = ahead + ALPHA * (seen - ahead)
        self.twist = self.twist + BETA / step * (seen - ahead)


def wrapped(angle: float) -> float:
    """The angle from -pi on and below pi."""
    return (angle + pi) % (2.0 * pi) - pi


def limited(vector: complex, most: float) -> complex:
    """The vector, or the one along it that is so long."""
    return vector if abs(vector) <= most else vector * (most / abs(vector))


def pulses(layout: Floats, heading: float, arm: complex, wrench: npt.ArrayLike) -> list[float]:
    """On times in a period that come nearest to a wrench about the centre of mass.

    Least squares between 0 and the period, by coordinate descent; a little weight on the times
    themselves makes the answer unique.

    Args:
        layout: (8, 3) force in the base's axes [N] and torque [N m] of each thruster.
        heading: of the base [rad].
        arm: from the centre of mass to the base's origin [m], world axes.
        wrench: (3,) force in world axes [N], torque [N m].
    """
    force = (layout[:, 0] + 1j * layout[:, 1]) * np.exp(1j * heading)
    torque = layout[:, 2] + (np.conj(arm) * force).imag
    scale = np.array([1.0, 1.0, 2.0])  # what a newton metre off is worth in newtons [1/m]
    effect = scale[:, None] * np.stack([force.real, force.imag, torque])
    H = effect.T @ effect + 1e-5 * np.eye(len(layout))
    g = effect.T @ (scale * np.asarray(wrench))
    duty = np.zeros(len(layout))
    for _ in range(60):
        for i in range(len(duty)):
            duty[i] = min(max(duty[i] + (g[i] - H[i] @ duty) / H[i, i], 0.0), 1.0)
    return [float(PERIOD * u) for u in duty]


class Guidance:
    """From what is seen to orders.

    Args:
        arm: as known, its base as heavy as it is now.
        target: as known.
        layout: (8, 3) of the thrusters.
    """

    def __init__(self, arm: Arm, target: Target, layout: Floats) -> None:
        self.p, self.target, self.layout = arm.vector(), target, layout
        self.n = arm.n
        self.base, self.tip, self.body = Track(), Track(), Track()  # updated by who sees them
        self.phase = "approach"
        self._side = 0j  # from which it comes, seen from the target
        self._momentum = np.zeros(3)
        self._calm = 0

    def orders(self, q_m: npt.ArrayLike, qd_m: npt.ArrayLike, holds: bool) -> Orders:
        """What to do now that the joints are at q_m and move at qd_m, (n,)."""
        q = np.concatenate([self.base.pose, q_m])
        qd = np.concatenate([self.base.twist, qd_m])
        if holds and self.phase in ("approach", "reach"):
            self.p = with_held(self.p, self.target, hold(self.p, q, self.body.pose))
            self.phase = "detumble"
        on_times, rates = 8 * [0.0], self.n * [0.0]
        if self.phase == "approach":
            on_times = self._approach(q, qd)
        elif self.phase == "reach":
            rates = self._reach(q, qd)
        elif self.phase == "detumble":
            on_times = self._stop(q, qd)
        return Orders(on_times, rates, self.phase != "approach", self.phase)

    def _whole(self, q: Floats, qd: Floats) -> tuple[float, float, complex, complex, float]:
        """Mass, moment of inertia, centre of mass, and its velocity and turning as one body."""
        H, c = inertia_matrix(self.p, q), complex(*system_com(self.p, q))
        mass = float(H[0, 0])
        moment = float(H[2, 2]) - mass * abs(c - complex(*q[:2])) ** 2
        if self.phase != "reach":  # in which no force acts and the joints' motion would disturb it
            self._momentum = momentum(self.p, q, qd)
        px, py, L = self._momentum.tolist()
        return mass, moment, c, complex(px, py) / mass, L / moment

    def _approach(self, q: Floats, qd: Floats) -> list[float]:
        """Thrust towards the place before the target, as fast as can be braked."""
        mass, moment, c, velocity, turning = self._whole(q, qd)
        body, drift = complex(*self.body.pose[:2]), complex(*self.body.twist[:2])
        if not self._side:
            self._side = (c - body) / abs(c - body)
        fixture = complex(*self.target.fixture[:2])
        tip = body + (abs(fixture) + STAND_OFF) * self._side
        tip_x, tip_y, tip_heading = tip_in_base(self.p, q[3:])
        heading = float(np.angle(-self._side)) - tip_heading
        askew = wrapped(heading - q[2])
        # Where the centre of mass is to be: it goes with the base as one body.
        place = tip - complex(tip_x, tip_y) * np.exp(1j * heading)
        aim = place + (c - complex(*q[:2])) * np.exp(1j * askew)
        off = aim - c
        self._begin_reach(abs(off), abs(askew), abs(velocity - drift), abs(turning))
        wanted = drift + limited(0.12 * off, SPEED)
        turn = min(max(0.2 * askew, -TURN), TURN)
        force = limited(0.4 * mass * (wanted - velocity), 0.3)
        torque = 0.8 * moment * (turn - turning)
        return pulses(self.layout, q[2], complex(*q[:2]) - c, [force.real, force.imag, torque])

    def _begin_reach(self, off: float, askew: float, speed: float, turning: float) -> None:
        """Reach once at rest before the target, when the fixture is about to face the arm."""
        there = off < 0.03 and askew < 0.05 and speed < 0.01 and turning < 0.01
        outward = self.body.pose[2] + self.target.fixture[2] + LEAD * self.body.twist[2]
        if there and abs(wrapped(outward - float(np.angle(self._side)))) < 0.15:
            self.phase = "reach"

    def _reach(self, q: Floats, qd: Floats) -> list[float]:
        """Joint rates that take the end effector onto the fixture; back off if that turns away."""
        _, _, c, velocity, turning = self._whole(q, qd)
        x, y, heading = self.tip.pose  # as seen: the joints are known with delay
        tip = complex(x, y)
        body, spin = complex(*self.body.pose[:2]), float(self.body.twist[2])
        out = complex(*self.target.fixture[:2]) * np.exp(1j * self.body.pose[2])
        wanted = complex(*self.body.twist[:2]) + 1j * spin * out
        wanted += limited(1.0 * (body + out - tip), REACH_SPEED)
        askew = wrapped(self.body.pose[2] + self.target.fixture[2] + pi - heading)
        if abs(askew) > 1.0:
            self.phase = "approach"
        turn = spin + min(max(0.6 * askew, -REACH_TURN), REACH_TURN)
        drift = velocity + 1j * turning * (tip - c)
        weight = np.array([1.0, 1.0, 0.1])  # to be there counts more than to be straight [m]
        J = weight[:, None] * generalized_jacobian(self.p, q)
        past = wanted - drift
        twist = weight * np.array([past.real, past.imag, turn - turning])
        damped = J @ J.T + 1e-3 * np.eye(3)
        rates = J.T @ np.linalg.solve(damped, twist)
        rates *= min(1.0, RATE / max(float(np.abs(rates).max()), 1e-9))
        return [float(rate) for rate in rates]

    def _stop(self, q: Floats, qd: Floats) -> list[float]:
        """Thrust against what moves."""
        mass, moment, c, velocity, turning = self._whole(q, qd)
        is_still = abs(velocity) < MOTION_THRESHOLD[0] and abs(turning) < MOTION_THRESHOLD[1]
        self._calm = self._calm + 1 if is_still else 0
        if self._calm * PERIOD >= 2.0:
            self.phase = "done"
        force = limited(-0.4 * mass * velocity, 0.3)
        torque = -0.4 * moment * turning
        return pulses(self.layout, q[2], complex(*q[:2]) - c, [force.real, force.imag, torque])
