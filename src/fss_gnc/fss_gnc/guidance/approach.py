"""Planning of the approach: motion of the base, joints held, to the stand-off from the fixture.

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

The fixture turns with the target. Times of arrival are tried, earliest first. At each, the side is
the one that the fixture then faces. Both directions around the target and several orders of moving
inward and around are tried. The first trajectory is chosen that the valves can produce and that
stays on the table and outside the keep-out zone. It must also do so for a while if all thrust ends
at any point on it (passive safety, as for a visiting vehicle: Fehse, Automated Rendezvous and
Docking of Spacecraft, 2003, section 4.4). It must be clear of other vehicles.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from math import pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model import layout
from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.clearance import gaps, sizes, with_edge, with_target
from fss_arm_model.dynamics import inertia_matrix, inverse_dynamics
from fss_arm_model.held import Target
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import system_com
from fss_arm_model.planar import wrap
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import (
    MIN_HORIZON,
    Conflict,
    OtherVehicle,
    conflicts,
    outline,
)

MAX_DURATION = 150.0  # of a planned approach [s]
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


@dataclass(frozen=True)
class ApproachTrajectory:
    """Trajectory from the start to the stand-off, in the target's drifting frame."""

    body: RigidCraft
    start: Floats  # (3,) d, phi, psi
    start_rate: Floats  # (3,)
    end: Floats  # (3,)
    duration: float  # [s]
    timing: "Timing"
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


class Timing(NamedTuple):
    """Timing of the motions inward and around the target, as shares of the duration."""

    turn_interval: tuple[float, float]  # start and end of the change of phi
    detour_end: float = 0.0  # end of a first motion of d to another distance
    detour_distance: float | None = None  # that distance [m]; None: straight in


class Planner:
    """Planner of approach trajectories.

    Args:
        p: Arm.vector(), with the present masses.
        settings: of the missions.
    """

    def __init__(self, p: Floats, settings: MissionSettings) -> None:
        self.p, self.settings, self.target = p, settings, settings.target
        n = (p.size - layout.BASE_SIZE) // layout.LINK_SIZE
        self._pairs = np.array([*with_target(n), *with_edge(n)], dtype=float)
        min_gaps = settings.keep_out - settings.target_radius
        self._min_gaps = np.array([min_gaps] * (n + 2) + [settings.approach_edge_gap] * (n + 2))
        self._sizes = sizes(settings, settings.target_radius, settings.gripper_length)

    def standoff_distance(self) -> float:
        """Return the end effector's distance from the target's centre after the approach [m]."""
        return float(abs(complex(*self.target.fixture[:2]))) + self.settings.stand_off

    def fixture_direction(self, heading: float) -> float:
        """Return the fixture's direction from the target's centre, at a target heading [rad]."""
        return heading + float(np.angle(complex(*self.target.fixture[:2])))

    def valve_load(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return the share of the valves' authority that the base's motion needs, (k,)."""
        w = inverse_dynamics(self.p, q, qd, qdd)[..., :3]
        return valve_load(w, q[..., 2], self.settings)

    def plan(self, q: Floats, qd: Floats, state: Floats, lead: float) -> ApproachTrajectory | None:
        """Return the quickest trajectory of `search`; None if there is none."""
        return next(
            (trajectory for trajectory in self.search(q, qd, state, lead) if trajectory), None
        )

    def search(
        self,
        q: Floats,
        qd: Floats,
        state: Floats,
        lead: float,
        others: Sequence[OtherVehicle] = (),
    ) -> Iterator[ApproachTrajectory | None]:
        """Yield feasible trajectories of base and arm, the quickest first; None for a failed try.

        Args:
            q: (3 + n,) state; its joints are held.
            qd: (3 + n,) rate of the state; the joints' rates are ignored.
            state: (2, 3) pose and twist of the target.
            lead: time from the end of a trajectory until the fixture faces the arm [s].
            others: the other vehicles at the start.
        """
        body = RigidCraft(self.p, q[3:])
        drift = np.array([*state[1, :2], 0.0])
        relative_pose = np.array([*(q[:2] - state[0, :2]), q[2]])
        initial = body.polar(relative_pose, qd[:3] - drift)
        if initial is None:
            return
        cancels = (True, False) if self.settings.cancel_momentum else (False,)
        for trajectory in chain.from_iterable(
            self._candidates(body, *initial, state, lead, each) for each in cancels
        ):
            yield (
                trajectory
                if self._is_feasible(trajectory)
                and self._is_clear(trajectory, state)
                and not self.conflicts(trajectory, 0.0, state, others, self.settings.vehicle_gap)
                else None
            )

    def _candidates(
        self,
        body: RigidCraft,
        initial: Floats,
        rate: Floats,
        state: Floats,
        lead: float,
        cancels_momentum: bool,
    ) -> Iterator[ApproachTrajectory]:
        distance = self.standoff_distance()
        outer = max(float(initial[0]), distance)
        timings = (
            Timing((0.0, 1.0)), Timing((0.0, 0.6), 0.45, outer), Timing((0.3, 1.0), 0.5, distance),
            Timing((0.0, 0.6), 0.4, outer + 0.3), Timing((0.1, 0.8), 0.2, outer + 0.1),
        )  # fmt: skip
        t = RAMP_TIME if cancels_momentum else 6.0
        final_rate, lag = np.zeros(3), 0.0
        while t < MAX_DURATION:
            facing = self.fixture_direction(float(state[0, 2] + state[1, 2] * (t + lead)))
            if cancels_momentum:
                # The final motion leads to the side where the fixture is while the arm reaches.
                lag = lead * body.canceling_rates(distance, facing, self.target, state)[1]
                final_rate = body.canceling_rates(distance, facing - lag, self.target, state)
            shorter = wrap(facing - initial[1])
            for turn in (shorter, shorter - np.copysign(2.0 * pi, shorter)):
                side = float(initial[1] + turn)
                end = np.array([distance, side - lag, -lead * final_rate[2]])
                for timing in timings:
                    yield ApproachTrajectory(body, initial, rate, end, t, timing, side, final_rate)
            t += max(1.0, 0.05 * t)

    def _is_feasible(self, trajectory: ApproachTrajectory) -> bool:
        points = trajectory.points(np.linspace(0.0, trajectory.duration, 25))
        q, qd, qdd = (self._with_joints(rows, trajectory) for rows in points)
        qd[:, 3:] = qdd[:, 3:] = 0.0
        return bool(self.valve_load(q, qd, qdd).max() <= self.settings.authority)

    def _is_clear(self, trajectory: ApproachTrajectory, state: Floats) -> bool:
        t = np.linspace(0.0, trajectory.duration, 40)[1:]
        relative = trajectory.points(t)
        drift = np.array([*state[1, :2], 0.0])
        target = state[0, :2] + t[:, None] * state[1, :2]
        pose = relative.pose + np.column_stack([target, np.zeros(t.size)])
        # A gap that is too small at the start must not become smaller.
        min_gaps = np.minimum(
            self._min_gaps, self.gaps_at(np.concatenate([pose[0], trajectory.body.q_m]), state[0])
        )
        if (self.gaps_along(pose, trajectory.body, target) < min_gaps - 1e-3).any():
            return False
        for ahead in np.array([0.25, 0.5, 0.75, 1.0]) * self.settings.coast:
            later = propagate_coast(pose, relative.twist + drift, trajectory.body.com, ahead)
            later_target = target + ahead * state[1, :2]
            if (
                self.gaps_along(later, trajectory.body, later_target) < np.minimum(min_gaps, 0.02)
            ).any():
                return False
        return True

    def conflicts(
        self,
        trajectory: ApproachTrajectory,
        since: float,
        state: Floats,
        others: Sequence[OtherVehicle],
        margin: float,
    ) -> list[Conflict]:
        """Return the conflicts with other vehicles of the rest of a trajectory.

        Args:
            trajectory: the approach.
            since: time since its start [s].
            state: (2, 3) pose and twist of the target now.
            others: the other vehicles.
            margin: smallest gap [m].
        """
        if not others:
            return []
        ahead = np.linspace(0.0, max(trajectory.duration - since, MIN_HORIZON), 40)
        target = state[0, :2] + ahead[:, None] * state[1, :2]
        pose = trajectory.points(since + ahead).pose + np.column_stack([target, np.zeros(40)])
        own = outline(self.p, trajectory.body.q_m, self.settings)
        return conflicts(own, ahead, pose, others, margin)

    def gaps_at(self, q: Floats, target: Floats) -> Floats:
        """Return the gaps of all bodies to target and edge, (g,)."""
        return np.asarray(gaps(self.p, q, self._pairs, self._sizes, target[:2]))

    def gaps_along(self, pose: Floats, body: RigidCraft, target: Floats) -> Floats:
        """Return the gaps with the base at poses (k, 3) and the target at (k, 2), (k, g)."""
        q = np.column_stack([pose, np.broadcast_to(body.q_m, (len(pose), body.q_m.size))])
        return np.asarray(gaps(self.p, q, self._pairs, self._sizes, target))

    @staticmethod
    def _with_joints(rows: Floats, trajectory: ApproachTrajectory) -> Floats:
        joints = np.broadcast_to(trajectory.body.q_m, (len(rows), trajectory.body.q_m.size))
        return np.column_stack([rows, joints])


def propagate_coast(pose: Floats, twist: Floats, com: complex, time: float | Floats) -> Floats:
    """Return poses (..., 3) of the base a time later [s], base and arm moving as one free body."""
    w = com * np.exp(1j * pose[..., 2])
    v = twist[..., 0] + 1j * twist[..., 1] + 1j * twist[..., 2] * w
    heading = pose[..., 2] + time * twist[..., 2]
    origin = pose[..., 0] + 1j * pose[..., 1] + w + time * v - com * np.exp(1j * heading)
    return np.stack([origin.real, origin.imag, heading], axis=-1)


def valve_load(wrench: Floats, heading: Floats, settings: MissionSettings) -> Floats:
    """Return the share of the valves' authority that wrenches (..., 3) in world axes need, (...).

    Four valves of thrust T and lever l push along each axis. Together they can produce

        |f_x|, |f_y| <= 2 T,   |f_x| + |f_y| + |tau| / l <= 4 T
    """
    force = (wrench[..., 0] + 1j * wrench[..., 1]) * np.exp(-1j * heading) / settings.thrust
    x, y = np.abs(force.real), np.abs(force.imag)
    torque = np.abs(wrench[..., 2]) / (settings.thrust * settings.lever)
    return np.asarray(np.maximum(0.5 * np.maximum(x, y), 0.25 * (x + y + torque)))
