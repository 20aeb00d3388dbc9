"""Straight moves in joint space, each from rest to rest with the drives' trapezoidal speed profile.

A pause between two moves lets the arm be seen to arrive.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from .arrays import Floats
from .description import Arm
from .free_floating import free_torques
from .joint_path import Law

RAMP_SHARE = 1.0 / 3.0  # share of a move's time for acceleration, and the same for deceleration
PAUSE = 0.5  # time between two moves, to detect that the arm has arrived [s]
TORQUE_SHARE = 0.7  # share of the drives' torque that moves may use; the rest is for control


def moves_law(waypoints: Floats, durations: Floats) -> tuple[Law, Floats]:
    """Return angles and rates of successive moves over time, and the edges of smooth parts.

    The moves are between waypoints (..., w + 1, n) [rad], with durations (..., w) [s]. An infinite
    duration is padding of a batch.
    """
    way, real = np.diff(waypoints, axis=-2), np.isfinite(durations)
    begins = np.cumsum(durations + PAUSE, axis=-1)
    begins = np.concatenate([np.zeros_like(begins[..., :1]), begins[..., :-1]], axis=-1)
    n, first = way.shape[-1], np.arange(durations[..., 0].size).reshape(*durations.shape[:-1], 1)

    def law(t: Floats) -> tuple[Floats, Floats]:
        k = first * durations.shape[-1]  # index of the current move in the batch
        for begin in np.moveaxis(begins[..., 1:], -1, 0):
            k = k + (t >= begin[..., None])
        k = np.broadcast_to(k, t.shape)
        duration, step = durations.ravel()[k], way.reshape(-1, n)[k]
        s, rate, _ = speed_profile((t - begins.ravel()[k]) / duration)
        rate = rate / duration
        place = waypoints.reshape(-1, n)[k + first]
        return place + step * s[..., None], step * rate[..., None]

    corners = np.array([0.0, RAMP_SHARE, 1.0 - RAMP_SHARE, 1.0])
    spans = np.where(real, durations, 0.0)[..., None] * corners
    edges = np.where(real, begins, 0.0)[..., None] + spans
    return law, edges.reshape(*durations.shape[:-1], -1)


def batch_law(waypoints: Sequence[Floats], durations: Sequence[Floats]) -> tuple[Law, Floats]:
    """Return the law and edges of several sequences of moves as one batch; padded edges are 0."""
    counts = np.array(list(map(len, durations)))
    k = np.arange(counts.max() + 1)
    padded = np.full((len(counts), counts.max()), inf)
    padded[k[:-1] < counts[:, None]] = np.concatenate(durations)
    rows = np.minimum(k, counts[:, None])
    knots = [each[row] for each, row in zip(waypoints, rows, strict=True)]
    return moves_law(np.array(knots), padded)


def speed_profile(x: Floats, ramp: float = RAMP_SHARE) -> tuple[Floats, Floats, Floats]:
    """Return position (0 to 1), rate and acceleration of a move at the share x of its time.

    `ramp`, up to 0.5, is the share of its time for acceleration, and the same for deceleration.
    """
    x = np.clip(x, 0.0, 1.0)
    top = 1.0 / (1.0 - ramp)
    y = np.minimum(x, 1.0 - x)
    is_ramp = y < ramp
    way = np.where(is_ramp, 0.5 * top / ramp * y**2, top * (y - 0.5 * ramp))
    rate = np.where(is_ramp, top / ramp * y, top)
    acceleration = np.where(is_ramp, np.where(x < 0.5, top / ramp, -top / ramp), 0.0)
    return np.where(x < 0.5, way, 1.0 - way), rate, acceleration


def speed_limited_duration(arm: Arm, way: Floats) -> Floats:
    """Return the least time of moves by `way` (..., n), limited by speed and acceleration [s]."""
    top = 1.0 / (1.0 - RAMP_SHARE)
    speeds = np.array([link.drive.max_velocity for link in arm.links])
    gains = np.array([link.drive.max_acceleration for link in arm.links])
    speed = np.max(top * np.abs(way) / speeds, axis=-1)
    gain = np.max(top / RAMP_SHARE * np.abs(way) / gains, axis=-1)
    return np.maximum(np.maximum(speed, np.sqrt(gain)), 0.1)


def torque_limited_duration(arm: Arm, begin: Floats, end: Floats) -> Floats:
    """Return the least time of moves (..., n), also limited by the drives' torque, (...) [s]."""
    least = speed_limited_duration(arm, end - begin)
    return least * torque_stretch(arm, begin, end, least)


def torque_stretch(
    arm: Arm, begin: Floats, end: Floats, durations: Floats | float, ramp: float = RAMP_SHARE
) -> Floats:
    """Return the factors (...) >= 1 by which moves (..., n) last longer due to the drives' torque.

    Without momentum, the torques of a path scale with the inverse square of its duration.

    Args:
        arm: the arm.
        begin: joint angles (..., n) [rad].
        end: joint angles (..., n) [rad].
        durations: durations (...) [s] before the torque is considered.
        ramp: share of the time for acceleration.
    """
    limits = TORQUE_SHARE * np.array(
        [link.drive.torque_constant * link.drive.max_current for link in arm.links]
    )
    x = np.linspace(0.0, 1.0, 31) + 1e-9
    s, rate, acceleration = (x[:, None] for x in speed_profile(x, ramp))
    q, way = begin[..., None, :], (end - begin)[..., None, :]
    torques = free_torques(arm.vector(), q + s * way, rate * way, acceleration * way)[0]
    share = np.max(np.abs(torques) / limits, axis=(-2, -1)) / durations**2
    return np.asarray(np.maximum(1.0, np.sqrt(share)))
