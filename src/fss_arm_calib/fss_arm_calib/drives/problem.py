"""The parameters of each joint's drive and torque sensor, by two linear regressions.

The arm's known masses set the scale. Over windows weighed by phi, a Hann window of the length W,
what the sensor shows is what the rigid arm passes (motion.py), less what its links' swinging on
their gears takes, which phi'' leaves little of (modulating functions, Shinbrot 1957):

    <phi, seen> = g (<phi, s> + X <phi, f> - c <phi'', M s> + zero + drift t)

with g = described / true gain, the crosstalk X of the force f across the link, the reduced inertia
M, and c a compliance that is fitted for the sake of the others: backlash is in it as well.

The drive's current then tells its torque constant K, the friction and the rotor's inertia J:

    K i = s + viscous v + (coulomb + more exp(-(v / v_s)^2)) sign v + J v' + ripple(q)

with s = seen / g - zero - drift t - X f, a ripple of P periods a turn, while the joint turns.
Deviations are robust ones, of residuals that belong together for BLOCK seconds (Liang & Zeger
1986): swinging links are no white noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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
DENSE = 0.05  # time between frames by which a rotor's inertia is told [s]
SURE = 3.0  # deviations by which something differs from nothing
CROSSTALK_KNOWN = 0.003  # largest deviation of a crosstalk that is told [m]


class Regression(NamedTuple):
    """Linear least squares with robust deviations."""

    x: Floats  # (p,)
    covariance: Floats  # (p, p)
    residuals: Floats  # (k,)
    blocks: int


@dataclass(frozen=True)
class Drive:
    """What is found of one joint."""

    values: Floats  # (11,) in the order of NAMES; NaN: refused
    covariance: Floats  # (11, 11)
    refused: dict[str, str]  # why, by name
    moving: float  # time for which it turned [s]
    residuals: tuple[float, float]  # root mean square of the sensor's [N m] and the drive's [A]


def regression(A: Floats, y: Floats, t: Floats, noise: float = 0.0) -> Regression:
    """Least squares of A x = y, whose errors may depend on each other for BLOCK seconds.

    Noise of a known deviation in the first column, which would draw its x to 0, is taken off the
    normal equations (Fuller 1987).
    """
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    noisy = np.zeros(A.shape[1])
    noisy[0] = noise**2
    normal = A.T @ A - len(A) * np.diag(noisy)
    P = np.linalg.pinv(normal / scale / scale[:, None], rcond=1e-10, hermitian=True)
    P = P / scale / scale[:, None]
    x = P @ (A.T @ y)
    left = y - A @ x
    _, of = np.unique(t // BLOCK, return_inverse=True)
    blocks = int(of.max()) + 1
    sums = np.zeros((blocks, A.shape[1]))
    np.add.at(sums, of, A * left[:, None] + noisy * x)
    # As many degrees of freedom are left as there are blocks less what is fitted.
    more = blocks / max(blocks - A.shape[1], 1)
    return Regression(x, more * P @ (sums.T @ sums) @ P, left, blocks)


class Windows:
    """What the rigid arm passes, over windows, and at the links' samples."""

    def __init__(self, arm: Arm, samples: Sequence[Samples], s: DrivesSettings) -> None:
        self.arm, self.length = arm, s.window
        self.motion = Motion(samples, s.periods)
        begin, end = self.motion.span
        t = np.arange(begin, end, GRID)
        moving = self.motion.at(t)
        torque, force = passed(arm, moving)
        half = round(0.5 * self.length / GRID)
        u = GRID * np.arange(-half, half + 1)
        turn = 2.0 * np.pi / self.length
        phi = 1.0 + np.cos(turn * u)
        bend = -(turn**2) * np.cos(turn * u) / phi.sum()
        bend -= bend.mean()
        phi /= phi.sum()
        middles = np.arange(half, len(t) - half, max(1, half // 2))
        self.t = t[middles]
        self.torque = _over(torque, phi, middles)
        self.force = _over(force, phi, middles)
        swing = _over(torque, bend, middles)
        self.swing = np.einsum("kij,kj->ki", _reduced(arm, moving.q[middles]), swing)

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


def sensor(w: Windows, one: Samples, j: int) -> Regression:
    """What a torque sensor shows against what the arm passes: zero, scale, drift, X, c."""
    seen, counts = w.seen(one)
    keep = counts >= 0.7 * w.length / one.period
    t = w.t[keep]
    columns = [
        np.ones(len(t)), w.torque[keep, j], (t - t.mean()) / 100.0, w.force[keep, j],
        -w.swing[keep, j],
    ]  # fmt: skip
    return regression(np.column_stack(columns), seen[keep], t)


@dataclass(frozen=True)
class Turning:
    """Samples of a drive while its joint turns, several next to each other as one."""

    t: Floats  # (k,) [s]
    v: Floats  # (k,) [rad/s]
    current: Floats  # (k,) [A]
    columns: Floats  # (k, 8) of the regression
    every: Floats  # (k, joined) all rates [rad/s]
    noise: float  # of the sensor's column [N m]

    @property
    def joined(self) -> int:
        """How many samples are one."""
        return self.every.shape[1]

    def fit(self, speed: float, more: float = 0.0) -> Regression:
        """The regression with a curve of Stribeck's; with its height, for a step of its speed."""
        bell = np.sign(self.every) * np.exp(-((self.every / speed) ** 2))
        columns = [self.columns, bell.mean(axis=1)[:, None]]
        if more:
            slope = more * 2.0 * self.every**2 / speed**3 * bell
            columns.append(slope.mean(axis=1)[:, None])
        return regression(np.column_stack(columns), self.current, self.t, self.noise)


def _turning(w: Windows, one: Samples, j: int, shown: Regression, s: DrivesSettings) -> Turning:
    """What the drive of a joint shows while it turns."""
    (begin, end), gap = w.motion.span, w.motion.width[j]
    m = w.motion.at(np.clip(one.t, begin, end))
    before, after = (w.motion.rates(one.t + way, j) for way in (-gap, gap))
    v = m.qd[:, j]
    turns = (one.t > begin) & (one.t < end) & (np.abs(v) > s.min_speed)
    turns &= np.minimum(before * v, after * v) > s.min_speed**2
    joined = max(1, round(JOINED / one.period))
    size = len(v) // joined * joined
    whole = turns[:size].reshape(-1, joined).all(axis=1)
    force = passed(w.arm, m)[1][:, j]
    # Between samples far apart, the links swing: what is interpolated there is less than it is.
    dense = one.period <= DENSE
    torque = np.interp(one.t, one.t - one.age, one.torque) if dense else one.torque
    seen = torque - shown.x[CROSSTALK] * force
    phase = s.periods * m.q[:, j]
    columns = [
        seen, np.ones(len(v)), (one.t - one.t.mean()) / 100.0, v, np.sign(v),
        (after - before) / (2.0 * gap), np.sin(phase), np.cos(phase),
    ]  # fmt: skip

    def means(x: Floats) -> Floats:
        return np.asarray(x[:size].reshape(-1, joined).mean(axis=1)[whole])

    return Turning(
        means(one.t), means(v), means(one.current), np.column_stack([means(x) for x in columns]),
        v[:size].reshape(-1, joined)[whole], s.torque_noise * abs(shown.x[SCALE]) / np.sqrt(joined),
    )  # fmt: skip


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
    shown = sensor(w, one, j)
    rows = _turning(w, one, j, shown, s)
    moving = one.period * rows.joined * len(rows.t)
    if moving < s.min_moving:
        reason = f"joint {j + 1} turns for {moving:.1f} s (at least {s.min_moving:g})"
        nothing = np.full((len(NAMES),) * 2, np.nan)
        return Drive(nothing[0], nothing, dict.fromkeys(NAMES, reason), moving, (np.nan, np.nan))
    fits = [rows.fit(speed) for speed in SPEEDS]
    best = int(np.argmin([fit.residuals @ fit.residuals for fit in fits]))
    speed, more = float(SPEEDS[best]), fits[best].x[8]
    for _ in range(STEPS):  # Gauss and Newton's, from there
        fit = rows.fit(speed, more)
        more = fit.x[8]
        speed += float(np.clip(fit.x[9], -0.3 * speed, 0.4 * speed))
        speed = float(np.clip(speed, SPEEDS[0], SPEEDS[-1]))
    x = np.concatenate([shown.x, fit.x])
    x[-1] = speed
    C = np.zeros((len(x), len(x)))
    C[:5, :5], C[5:, 5:] = shown.covariance, fit.covariance
    values = _parameters(x, arm, j)
    steps = np.sqrt(np.diag(C)) * 1e-3 + 1e-15
    jacobian = np.column_stack(
        [
            (_parameters(x + h, arm, j) - _parameters(x - h, arm, j)) / (2.0 * h.sum())
            for h in np.diag(steps)
        ]
    )
    covariance = jacobian @ C @ jacobian.T
    rms = tuple(float(np.sqrt(np.mean(r.residuals**2))) for r in (shown, fit))
    refused = _refused(values, covariance, rows, one, s)
    return Drive(values, covariance, refused, moving, (rms[0], rms[1]))


def _parameters(x: Floats, arm: Arm, j: int) -> Floats:
    """(11,) from what the regressions of a joint found."""
    g, current = x[SCALE], x[5:]
    K = 1.0 / (g * current[0])
    found = np.full(len(NAMES), np.nan)
    found[KT], found[GAIN] = K, arm.links[j].torque_sensor.gain / g
    found[ZERO], found[CROSS] = x[0] / g, x[CROSSTALK] / g
    found[VISCOUS], found[COULOMB], found[ROTOR] = K * current[3:6]
    found[STATIC], found[SPEED] = K * (current[4] + current[8]), current[9]
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
            f"frames {1e3 * one.period:.0f} ms apart (at most {1e3 * DENSE:.0f}) do not tell "
            "accelerations well enough"
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
