"""Whether a point can be reached, found out by trying: inverse kinematics by descent."""

import numpy as np
from scipy.spatial import cKDTree

from fss_arm_model.kinematics import tip_in_base, tip_jacobian


def tips(p, q):
    tip = tip_in_base(p, q)
    return tip[..., 0] + 1j * tip[..., 1]


def sampled(p, limits, count, rng):
    """Random postures, a third of the joints at a limit, and their tips."""
    q = rng.uniform(limits[:, 0], limits[:, 1], (count, len(limits)))
    ends = np.where(rng.random(q.shape) < 0.5, limits[:, 0], limits[:, 1])
    q = np.where(rng.random(q.shape) < 1 / 3, ends, q)
    return q, tips(p, q)


def descend(p, limits, points, q, steps=60):
    """Projected, damped Gauss-Newton towards the points (m,); return q and the distances left."""
    q, damping = q.copy(), np.full(len(q), 1e-4)
    error = points - tips(p, q)
    live = np.abs(error) > 1e-12
    for _ in range(steps):
        index = np.flatnonzero(live)
        if not index.size:
            break
        state = np.concatenate([np.zeros((len(index), 3)), q[index]], axis=1)
        J = tip_jacobian(p, state)[:, :2, 3:]
        e = np.stack([error[index].real, error[index].imag], axis=-1)
        pull = np.einsum("krn,kr->kn", J, e)
        stuck = ((q[index] <= limits[:, 0]) & (pull < 0)) | (
            (q[index] >= limits[:, 1]) & (pull > 0)
        )
        J = np.where(stuck[:, None, :], 0.0, J)
        A = J @ J.transpose(0, 2, 1) + damping[index, None, None] * np.eye(2)
        step = np.einsum("krn,kr->kn", J, np.linalg.solve(A, e[..., None])[..., 0])
        new = np.clip(q[index] + np.clip(step, -0.5, 0.5), limits[:, 0], limits[:, 1])
        left = points[index] - tips(p, new)
        better = np.abs(left) < np.abs(error[index])
        q[index[better]], error[index[better]] = new[better], left[better]
        damping[index] = np.maximum(damping[index] * np.where(better, 0.1, 10.0), 1e-12)
        live[index] = (np.abs(error[index]) > 1e-12) & (damping[index] < 1e8)
    return q, np.abs(error)


def reachable(p, limits, points, rng, hopes=None, samples=100_000, starts=6, good=1e-9):
    """Which points (m,) a posture within the limits was found for.

    Descends from the nearest samples; for those of `hopes` (m,) that this fails for, from many
    more. A posture found is a proof, whatever made one look for it.
    """
    q, tip = sampled(p, limits, samples, rng)
    tree = cKDTree(np.stack([tip.real, tip.imag], axis=-1))
    near = tree.query(np.stack([points.real, points.imag], axis=-1), k=starts)[1]
    found = np.zeros(len(points), dtype=bool)
    for k in range(starts):
        rest = np.flatnonzero(~found)
        found[rest] = descend(p, limits, points[rest], q[near[rest, k]])[1] < good
    for _ in range(0 if hopes is None else 300):
        rest = np.flatnonzero(hopes & ~found)
        start = q[rng.integers(samples, size=len(rest))]
        found[rest] = descend(p, limits, points[rest], start)[1] < good
    return found


def elbows(arm, point, q1, q2):
    """All postures of four links with the tip at a point and the first two joints given.

    The last two are a triangle whose elbow is on either side; shapes (2, ..., 4), NaN where none.
    """
    a = [link.a for link in arm.links]
    offset = [arm.base.mount[2], *(link.theta_0 for link in arm.links[1:])]
    heading = q1 + offset[0]
    joint = complex(*arm.base.mount[:2]) + a[0] * np.exp(1j * heading)
    heading = heading + q2 + offset[1]
    joint = joint + a[1] * np.exp(1j * heading)
    rest = point - joint
    with np.errstate(invalid="ignore"):
        bend = np.arccos((np.abs(rest) ** 2 - a[2] ** 2 - a[3] ** 2) / (2.0 * a[2] * a[3]))
    bend = np.stack([bend, -bend])
    first = np.angle(rest) - np.angle(a[2] + a[3] * np.exp(1j * bend)) - heading
    q = [q1 + 0.0 * bend, q2 + 0.0 * bend, first - offset[2], bend - offset[3]]
    q = np.stack(np.broadcast_arrays(*q), axis=-1)
    return (q + np.pi) % (2.0 * np.pi) - np.pi


def exhaustive(arm, limits, point, measure, count=100, peaks=24, zooms=16):
    """The largest `measure(q)` of four links over a grid of the first two joints, then finer."""

    def scan(q1, q2):
        q = elbows(arm, point, q1, q2)
        good = ((q >= limits[:, 0]) & (q <= limits[:, 1])).all(axis=-1)
        w = np.full(good.shape, -1.0)
        w[good] = measure(q[good])
        return w

    axes = [np.linspace(low, high, count) for low, high in limits[:2]]
    q1, q2 = np.meshgrid(*axes, indexing="ij")
    w = scan(q1, q2)
    best = w.max()
    padded = np.pad(w, ((0, 0), (1, 1), (1, 1)), constant_values=-1.0)
    around = [padded[:, i : i + count, j : j + count] for i in range(3) for j in range(3)]
    tops = np.flatnonzero((w >= np.max(around, axis=0)) & (w > 0.0))
    tops = tops[np.argsort(-w.ravel()[tops])][:peaks] % q1.size
    x, y, size = q1.ravel()[tops], q2.ravel()[tops], [axis[1] - axis[0] for axis in axes]
    grid = np.linspace(-1.0, 1.0, 9)
    for _ in range(zooms):
        fine = x[:, None, None] + size[0] * grid[:, None] + 0.0 * grid
        other = y[:, None, None] + 0.0 * grid[:, None] + size[1] * grid
        w = scan(fine, other).max(axis=0).reshape(len(x), -1)
        k = w.argmax(axis=1)
        best = max(best, w.max(initial=-1.0))
        x, y = (m.reshape(len(x), -1)[np.arange(len(x)), k] for m in (fine, other))
        size = [0.6 * s for s in size]
    return best
