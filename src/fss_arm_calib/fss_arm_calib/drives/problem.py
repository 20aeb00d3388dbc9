"""The parameters of each joint's drive and torque sensor, by two linear regressions.

The arm's known masses set the scale. Over windows weighed by phi, a Hann window of the length W,
what the sensor shows is what the rigid arm passes (motion.py), less what its links' swinging on
their gears takes, which phi'' leaves little of (modulating functions, Shinbrot 1957):

    <phi, seen> = g (<phi, s> + X <phi, f> - c <phi'', M s> + zero + drift t)

with g = described / true gain, the crosstalk X of the force f across the link, the reduced inertia
M, and c a compliance that is fitted for the sake of the others: backlash is in it as well.

The drive's current then tells its torque constant K and the friction while the joint turns:

    K i = s + J v' + viscous v + (coulomb + more exp(-(v / v_s)^2)) sign v + ripple(q)

with s = seen / g - zero - drift t - X f and a ripple of P periods a turn. Its solution has Z' (i -
A x) = 0. Frames close together tell the rotor's inertia J by how the links swing, and Z is A.
Between frames far apart J is taken as known, and nobody knows how the links have swung from when a
torque was sampled to when a current was: least squares would find 1 / K too small by some percent.
What the rigid arm passes is not in that error and stands for s in Z (instrumental variables: Young
1970; Janot, Vandanjon & Gautier 2014).

Swinging links are no white noise: residuals belong together for BLOCK seconds. Deviations are the
jackknife's, of both regressions without each block (Bell & McCaffrey 2002; MacKinnon, Nielsen &
Webb 2023), so that what the second has from the first, and blocks that tell more than others, are
in them. Their number makes them Student's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fss_arm_calib.drives.motion import Motion, Samples, passed
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import inertia_matrix

GRID = 0.02  # of the integrals [s]
BLOCK = 4.0  # in which residuals may depend on each other [s]
SPEEDS = np.geomspace(0.01, 0.3, 18)  # among which Stribeck's is looked for [rad/s]

SCALE, DRIFT, CROSSTALK, COMPLIANCE = range(1, 5)  # of the sensor's regression; 0: its zero
MORE, STEP, INERTIA = range(7, 10)  # of the drive's

#: Of each joint, in this order, with units.
NAMES = {
    "torque_constant": "N m/A",
    "torque_gain": "N m/count",
    "torque_zero": "N m",
    "torque_crosstalk": "m",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "static": "N m",
    "stribeck_speed": "rad/s",
    "rotor_inertia": "kg m^2",
    "stiffness": "N m/rad",
    "dead_band": "rad",
}
KT, GAIN, ZERO, CROSS, VISCOUS, COULOMB, STATIC, SPEED, ROTOR, STIFFNESS, BAND = range(len(NAMES))


_NAME = tuple(NAMES)
JOINED = 0.2  # samples that are taken together where they are dense [s]
STEPS = 8
DENSE = 0.015  # time between frames that tell how links swing [s]
ROTOR_KNOWN = 0.1  # deviation of a rotor's inertia by its data sheet, against it
SURE = 3.0  # deviations by which something differs from nothing
CROSSTALK_KNOWN = 0.003  # largest deviation of a crosstalk that is told [m]


@dataclass(frozen=True)
class Drive:
    """What is found of one joint."""

    values: Floats  # (11,) in the order of NAMES; NaN: refused
    covariance: Floats  # (11, 11)
    refused: dict[str, str]  # why, by name
    moving: float  # time for which it turned [s]
    residuals: tuple[float, float]  # root mean square of the sensor's [N m] and the drive's [A]


def regression(A: Floats, y: Floats, Z: Floats) -> Floats:
    """The x of Z' (y - A x) = 0, 0 in columns of nothing; with Z = A, that of least squares."""
    a, z = (np.where(norm, norm, 1.0) for norm in np.linalg.norm([A, Z], axis=1))
    return np.asarray(np.linalg.pinv((Z / z).T @ (A / a), rcond=1e-10) @ ((Z / z).T @ y) / a)


class Windows:
    """What the rigid arm passes, over windows in which its motion is known."""

    def __init__(self, arm: Arm, samples: Sequence[Samples], s: DrivesSettings) -> None:
        self.arm, self.length = arm, s.window
        self.motion = Motion(samples, s.periods, s.joint_gap)
        parts = [self._of(begin, end) for begin, end in self.motion.runs]
        none = np.empty((0, arm.n))
        columns = zip(*parts, strict=True) if parts else [[none[:, 0]], [none], [none], [none]]
        self.t, self.torque, self.force, self.swing = map(np.concatenate, columns)

    def _of(self, begin: float, end: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Middles (w,), and torque, force and swing (w, n), between two times."""
        t = np.arange(begin, end, GRID)
        moving = self.motion.at(t)
        torque, force = passed(self.arm, moving)
        half = round(0.5 * self.length / GRID)
        u = GRID * np.arange(-half, half + 1)
        turn = 2.0 * np.pi / self.length
        phi = 1.0 + np.cos(turn * u)
        bend = -(turn**2) * np.cos(turn * u) / phi.sum()
        bend -= bend.mean()
        phi /= phi.sum()
        middles = np.arange(half, len(t) - half, max(1, half // 2))
        swing = _over(torque, bend, middles)
        swing = np.einsum("kij,kj->ki", _reduced(self.arm, moving.q[middles]), swing)
        return t[middles], _over(torque, phi, middles), _over(force, phi, middles), swing

    def seen(self, one: Samples) -> tuple[Floats, Floats]:
        """Mean (w,) of a sensor's samples in each window, and how many there are."""
        half, means, counts = 0.5 * self.length, [], []
        low = np.searchsorted(one.t, self.t - half)
        high = np.searchsorted(one.t, self.t + half)
        for a, b, middle in zip(low.tolist(), high.tolist(), self.t.tolist(), strict=True):
            weight = 1e-9 + 1.0 + np.cos(np.pi * (one.t[a:b] - one.age[a:b] - middle) / half)
            counts.append(b - a)
            means.append(float(weight @ one.torque[a:b] / weight.sum()) if b > a else 0.0)
        return np.array(means), np.array(counts, dtype=float)


def _over(x: Floats, kernel: Floats, middles: np.ndarray) -> Floats:
    """Integrals (w, n) of columns (k, n) with a kernel about each middle."""
    every = [np.convolve(column, kernel[::-1], "same") for column in x.T]
    return np.column_stack(every)[middles]


def _reduced(arm: Arm, q: Floats) -> Floats:
    """Inertia (k, n, n) that the joints of the floating arm feel."""
    H = inertia_matrix(arm.vector(), np.concatenate([np.zeros((len(q), 3)), q], axis=1))
    free = np.linalg.solve(H[:, :3, :3], H[:, :3, 3:])
    return np.asarray(H[:, 3:, 3:] - np.swapaxes(H[:, :3, 3:], 1, 2) @ free)


class Equations(NamedTuple):
    """A x = y, of which Z' (y - A x) = 0 is solved."""

    A: Floats  # (k, p)
    y: Floats  # (k,)
    t: Floats  # (k,) [s]
    Z: Floats  # (k, p)

    def solved(self, without: float = -1.0) -> Floats:
        """The x (p,) of all blocks but one."""
        keep = self.t // BLOCK != without
        return regression(self.A[keep], self.y[keep], self.Z[keep])


def sensor(w: Windows, one: Samples, j: int) -> Equations:
    """What a torque sensor shows against what the arm passes: zero, scale, drift, X, c."""
    seen, counts = w.seen(one)
    keep = counts >= 0.7 * w.length / one.period
    t = w.t[keep]
    columns = [
        np.ones(len(t)), w.torque[keep, j], (t - t.mean()) / 100.0, w.force[keep, j],
        -w.swing[keep, j],
    ]  # fmt: skip
    A = np.column_stack(columns)
    return Equations(A, seen[keep], t, A)


@dataclass(frozen=True)
class Turning:
    """Samples of a drive while its joint turns, several next to each other as one."""

    t: Floats  # (k,) [s]
    v: Floats  # (k,) [rad/s]
    current: Floats  # (k,) [A]
    torque: Floats  # (k,) as its sensor shows it [N m]
    passed: Floats  # (k,) by the rigid arm [N m]
    force: Floats  # (k,) [N]
    gain: Floats  # (k,) of the rate [rad/s^2]
    others: Floats  # (k, 6) of the regression: zero, drift, friction, ripple
    every: Floats  # (k, joined) all rates [rad/s]
    rotor: float | None  # its inertia; None: it is told [kg m^2]

    @property
    def joined(self) -> int:
        """How many samples are one."""
        return self.every.shape[1]

    def equations(self, shown: Floats, speed: float, more: float = 0.0) -> Equations:
        """Those of the current, with a curve of Stribeck's.

        Args:
            shown: (5,) what `sensor` says.
            speed: of the curve [rad/s].
            more: its height [A], for a step of its speed; 0: the step is none.
        """
        torque = self.torque - shown[CROSSTALK] * self.force
        bell = np.sign(self.every) * np.exp(-((self.every / speed) ** 2))
        slope = more * 2.0 * self.every**2 / speed**3 * bell
        curve = bell.mean(axis=1), slope.mean(axis=1)
        if self.rotor is None:
            A = Z = np.column_stack([torque, self.others, *curve, self.gain])
        else:
            torque += shown[SCALE] * self.rotor * self.gain
            A = np.column_stack([torque, self.others, *curve])
            Z = np.column_stack([self.passed, A[:, 1:]])
        return Equations(A, self.current, self.t, Z)


def _turning(w: Windows, one: Samples, j: int, s: DrivesSettings) -> Turning:
    """What the drive of a joint shows while it turns."""
    gap = w.motion.width[j]
    v, before, after = (w.motion.rates(one.t + way, j) for way in (0.0, -gap, gap))
    turns = w.motion.known(one.t) & (np.abs(v) > s.min_speed)
    turns &= np.minimum(before * v, after * v) > s.min_speed**2
    joined = max(1, round(JOINED / one.period))
    whole = turns[: len(v) // joined * joined].reshape(-1, joined).all(axis=1)
    which = np.flatnonzero(np.repeat(whole, joined))
    t, v, dense = one.t[which], v[which], one.period <= DENSE
    m = w.motion.at(t)
    # An instrument halfway has as much in common with a torque before as with a current after it.
    torque = passed(w.arm, w.motion.at(t - 0.5 * one.age[which]))[0][:, j]
    seen = (_now(one) if dense else one.torque)[which]
    phase = s.periods * m.q[:, j]
    others = [
        np.ones(len(v)), (t - one.t.mean()) / 100.0, v, np.sign(v), np.sin(phase), np.cos(phase),
    ]  # fmt: skip

    def means(x: Floats) -> Floats:
        return np.asarray(x.reshape(-1, joined).mean(axis=1))

    return Turning(
        means(t), means(v), means(one.current[which]), means(seen), means(torque),
        means(passed(w.arm, m)[1][:, j]), means((after - before)[which] / (2.0 * gap)),
        np.column_stack([means(x) for x in others]), v.reshape(-1, joined),
        None if dense else s.rotor_inertia,
    )  # fmt: skip


def _now(one: Samples) -> Floats:
    """Torques at the frames' own times; lines between samples would flatten what swings."""
    from scipy.interpolate import CubicSpline  # takes long, and no --help needs it

    fresh = np.diff(one.torque, prepend=np.nan) != 0.0  # else the sample before is reported again
    fresh[-1] = True
    t, which = np.unique((one.t - one.age)[fresh], return_index=True)
    return np.asarray(CubicSpline(t, one.torque[fresh][which])(one.t))


def solve(arm: Arm, samples: Sequence[Samples], s: DrivesSettings) -> list[Drive]:
    """The drives of all joints.

    Args:
        arm: as it is known; its masses set the scale.
        samples: of each link.
        s: what is known and asked for.
    """
    w = Windows(arm, samples, s)
    return [_drive(w, arm, samples[j], j, s) for j in range(arm.n)]


def _drive(w: Windows, arm: Arm, one: Samples, j: int, s: DrivesSettings) -> Drive:
    rows = _turning(w, one, j, s)
    moving = one.period * rows.joined * len(rows.t)
    if moving < s.min_moving:
        reason = f"joint {j + 1} turns for {moving:.1f} s (at least {s.min_moving:g})"
        nothing = np.full((len(NAMES),) * 2, np.nan)
        return Drive(nothing[0], nothing, dict.fromkeys(NAMES, reason), moving, (np.nan, np.nan))
    windows = sensor(w, one, j)
    shown = windows.solved()

    def squares(speed: float) -> float:
        left = _left(rows.equations(shown, speed))
        return float(left @ left)

    speed, more = min(SPEEDS.tolist(), key=squares), 0.0
    for k in range(STEPS):  # Gauss and Newton's, from there
        fit = rows.equations(shown, speed, more).solved()
        more = fit[MORE]
        if k:
            speed += float(np.clip(fit[STEP], -0.3 * speed, 0.4 * speed))
            speed = float(np.clip(speed, SPEEDS[0], SPEEDS[-1]))

    def found(without: float = -1.0, rows: Turning = rows) -> Floats:
        first = windows.solved(without)
        second = rows.equations(first, speed, more).solved(without)
        return _parameters(first, second, speed, arm, j)

    values, turning = found(), np.unique(rows.t // BLOCK)
    blocks = np.unique(np.concatenate([windows.t // BLOCK, turning]))
    shifts = np.array([found(block) for block in blocks]) - values
    freedom = len(turning) - 1
    student = freedom / max(freedom - 2, 1)  # his variance, where a normal one's is 1
    covariance = student * freedom / len(turning) * shifts.T @ shifts
    if rows.rotor is not None:
        other = found(rows=replace(rows, rotor=(1.0 + ROTOR_KNOWN) * rows.rotor)) - values
        covariance += np.outer(other, other)
    left = _left(windows), _left(rows.equations(shown, speed, more))
    torque, current = (float(np.sqrt(np.mean(each**2))) for each in left)
    refused = _refused(values, covariance, rows, one, s)
    return Drive(values, covariance, refused, moving, (torque, current))


def _left(e: Equations) -> Floats:
    """Residuals (k,)."""
    return e.y - e.A @ e.solved()


def _parameters(shown: Floats, x: Floats, speed: float, arm: Arm, j: int) -> Floats:
    """(11,) from what the regressions of a joint found, with a curve of a speed."""
    g = shown[SCALE]
    K = 1.0 / (g * x[0])
    found = np.full(len(NAMES), np.nan)
    found[KT], found[GAIN] = K, arm.links[j].torque_sensor.gain / g
    found[ZERO], found[CROSS] = shown[0] / g, shown[CROSSTALK] / g
    found[VISCOUS], found[COULOMB] = K * x[3:5]
    found[STATIC], found[SPEED] = K * (x[4] + x[MORE]), speed + x[STEP]
    found[ROTOR] = K * x[INERTIA] if len(x) > INERTIA else np.nan
    return found


def _refused(
    values: Floats, covariance: Floats, rows: Turning, one: Samples, s: DrivesSettings
) -> dict[str, str]:
    """Why parameters cannot be told, by name; they become NaN."""
    sigma = np.sqrt(np.diag(covariance))
    why: dict[str, str] = {}
    for k in (KT, GAIN, VISCOUS, COULOMB, STATIC):
        if not sigma[k] <= s.max_relative * abs(values[k]):
            why[_NAME[k]] = f"{values[k]:.3g} ± {sigma[k]:.1g} (at most {s.max_relative:.0%})"
    speed = values[SPEED]
    below = one.period * rows.joined * np.count_nonzero(np.abs(rows.v) < 0.05)
    excess = values[STATIC] - values[COULOMB]
    spread = covariance[STATIC, STATIC] + covariance[COULOMB, COULOMB]
    spread = np.sqrt(max(spread - 2.0 * covariance[STATIC, COULOMB], 0.0))
    if not excess > SURE * spread or not SPEEDS[0] < speed < SPEEDS[-1]:
        words = f"static friction exceeds Coulomb's by {excess:.2g} ± {spread:.1g} N m"
        words += f"; {below:.0f} s below 0.05 rad/s were seen"
        why["static"] = why["stribeck_speed"] = words
    if one.period > DENSE:
        why["rotor_inertia"] = (
            f"frames {1e3 * one.period:.0f} ms apart (at most {1e3 * DENSE:.0f}) do not tell how "
            f"links swing; taken as {rows.rotor:g} kg m^2"
        )
    elif not values[ROTOR] > SURE * sigma[ROTOR]:
        why["rotor_inertia"] = f"{values[ROTOR]:.2g} ± {sigma[ROTOR]:.1g} kg m^2 may be none"
    if not sigma[CROSS] <= CROSSTALK_KNOWN:
        why["torque_crosstalk"] = f"± {sigma[CROSS]:.1g} m (at most {CROSSTALK_KNOWN:g})"
    way = s.min_speed * one.period
    why["dead_band"] = (
        f"the encoder is on the motor: in {1e3 * one.period:.0f} ms between frames it turns "
        f"{1e3 * way:.2g} mrad at the least speed, and a gap within that is not seen"
    )
    why["stiffness"] = "the encoder is on the motor and does not see the twist of the gear"
    for name in why:
        k = _NAME.index(name)
        values[k] = np.nan
        covariance[k], covariance[:, k] = np.nan, np.nan
    return why
