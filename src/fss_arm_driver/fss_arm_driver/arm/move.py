"""Move in which all joints start and arrive together: one trapezoid, scaled for each joint.

With s from 0 to 1 as the common path, joint i turns by d_i s(t): its profile velocity is
|d_i| V and its acceleration |d_i| A for the rate V and acceleration A of s. These are the largest
that no joint's velocity and acceleration forbids, and that leave the drives torque for control. The
drives run the profiles by themselves.

A frame gives an acceleration in steps that are coarse for a slow joint. Such a joint accelerates
faster than its part, to a velocity with which it still arrives with the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, copysign, sqrt

import numpy as np

from fss_arm_driver.scale import Scale
from fss_arm_model.description import Arm, Link
from fss_arm_model.straight_moves import torque_stretch
from fss_arm_model.units import angle_beyond

MIN_TRAVEL = 1e-9  # a shorter way needs no profile [rad]
MAX_DURATION = 3600.0  # of any motion [s]
MIN_KEEP_ALIVE = 0.05  # [s]; less than a client on Wi-Fi can keep
STEPS = 50  # least acceleration, in steps of a frame, so that rounding changes it by 1% at most


class MoveError(ValueError):
    """Error of an invalid move; the message names joint, value and limits."""


@dataclass(frozen=True)
class Profile:
    """Profile of one joint in a move; velocity and acceleration are 0 if the joint stays."""

    target: float  # [rad]
    velocity: float  # [rad/s]
    acceleration: float  # [rad/s^2]

    def at(self, start: float, t: float) -> tuple[float, float]:
        """Return angle [rad] and rate [rad/s] at time t [s] since it left `start` at rest."""
        way = self.target - start
        if not self.velocity or abs(way) <= MIN_TRAVEL:
            return self.target, 0.0
        a, d = self.acceleration, abs(way)
        v = min(self.velocity, sqrt(a * d))
        lasts = d / v + v / a
        t = min(max(t, 0.0), lasts)
        left = lasts - t
        rate = min(a * t, v, a * left)
        if t > lasts - v / a:
            gone = d - 0.5 * a * left**2
        else:
            gone = 0.5 * a * t**2 if t < v / a else v * (t - 0.5 * v / a)
        return start + copysign(gone, way), copysign(rate, way)


@dataclass(frozen=True)
class Move:
    """A planned move."""

    start: tuple[float, ...]  # [rad]
    profiles: tuple[Profile, ...]
    duration: float  # [s]

    def at(self, t: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return angles [rad] and rates [rad/s] of all joints at time t since the start [s]."""
        states = [p.at(q, t) for p, q in zip(self.profiles, self.start, strict=True)]
        return tuple(q for q, _ in states), tuple(qd for _, qd in states)


def plan(arm: Arm, q: tuple[float, ...], goal: tuple[float, ...], duration: float = 0.0) -> Move:
    """Plan the move of all joints from `q` to `goal`, both (n) readings [rad].

    Args:
        arm: the limits.
        q: present angles of the joints, at rest.
        goal: desired angles.
        duration: desired duration [s]; if the limits do not allow it (such as 0), the shortest
            possible one, for an arm without momentum.

    Raises:
        MoveError: the goal is invalid (see `check`).
    """
    check(arm, goal, duration)
    way = [d if (d := abs(b - a)) > MIN_TRAVEL else 0.0 for a, b in zip(q, goal, strict=True)]
    drives = [link.drive for link in arm.links]
    if not any(way):
        return Move(q, tuple(Profile(angle, 0.0, 0.0) for angle in goal), 0.0)
    gain = min(k.max_acceleration / d for k, d in zip(drives, way, strict=True) if d)
    rate = min(k.max_velocity / d for k, d in zip(drives, way, strict=True) if d)
    rate = min(rate, sqrt(gain))  # a short way ends before its limit is reached
    fastest = 1.0 / rate + rate / gain
    ends, ramp = np.array([q, goal]), rate / gain / fastest
    stretch = torque_stretch(arm, ends[0], ends[1], fastest, ramp)
    lasts = max(fastest * float(stretch), duration)
    gain *= (fastest / lasts) ** 2
    profiles = tuple(
        _profile(link, angle, d, d * gain, lasts)
        for link, angle, d in zip(arm.links, goal, way, strict=True)
    )
    return Move(q, profiles, lasts)


def load_kernel(arm: Arm) -> None:
    """Load the kernel of `plan` in advance, because that takes long."""
    torque_stretch(arm, np.zeros(arm.n), np.ones(arm.n), 1.0)


def check(arm: Arm, goal: Sequence[float], duration: float = 0.0, keep_alive: float = 0.0) -> None:
    """Check a requested move independently of the arm's state: angles [rad], times [s].

    Raises:
        MoveError: wrong number of joints, a goal beyond a limit, or a time out of range.
    """
    if len(goal) != arm.n:
        raise MoveError(f"q has {len(goal)} joints, expected {arm.n}")
    for name, time in (("duration", duration), ("keep_alive", keep_alive)):
        if not 0.0 <= time <= MAX_DURATION:
            raise MoveError(f"{name} is {time} s, expected 0 to {MAX_DURATION:.0f}")
    if 0.0 < keep_alive < MIN_KEEP_ALIVE:
        raise MoveError(f"keep_alive is {keep_alive} s, expected 0 or {MIN_KEEP_ALIVE:g} or more")
    for i, (link, angle) in enumerate(zip(arm.links, goal, strict=True), 1):
        if not link.q_min <= angle <= link.q_max:
            raise MoveError(f"q of joint {i} is {angle_beyond(angle, link.q_min, link.q_max)}")


def _profile(link: Link, target: float, way: float, acceleration: float, lasts: float) -> Profile:
    """Return one joint's profile; its acceleration may be raised to the resolution of a frame."""
    if not way:
        return Profile(target, 0.0, 0.0)
    scale, drive = Scale(link), link.drive
    acceleration = min(max(acceleration, STEPS * scale.acceleration_step), drive.max_acceleration)
    # lasts = way / velocity + velocity / acceleration
    root = sqrt(max(0.0, 1.0 - 4.0 * way / (acceleration * lasts**2)))
    velocity = 2.0 * way / lasts / (1.0 + root)
    steps = ceil(velocity / scale.velocity_step)  # rather early than too late
    return Profile(target, min(steps * scale.velocity_step, drive.max_velocity), acceleration)
