"""The least time between two postures by direct transcription, which shares nothing with plans.

Its results for some postures are the table of `test/pure/motion/test_plans.py`.
"""

import numpy as np
import pinocchio as pin
from model_oracles import pinocchio_model
from scipy.optimize import linprog
from scipy.sparse import lil_matrix


class Floating:
    """Joint torques on a base that floats without momentum, in Pinocchio."""

    def __init__(self, arm):
        self.model = pinocchio_model(arm)
        self.data = self.model.createData()

    def torques(self, q, qd, qdd):
        """Return the torques (n,) [N m] for angles, rates and accelerations (n,) of the joints."""
        state = np.concatenate([np.zeros(3), q])
        H = pin.crba(self.model, self.data, state)
        H = np.triu(H) + np.triu(H, 1).T
        twist = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ qd)
        h = pin.rnea(
            self.model, self.data, state, np.concatenate([twist, qd]), np.zeros(3 + len(q))
        )
        force = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ qdd + h[:3])
        return H[3:, :3] @ force + H[3:, 3:] @ qdd + h[3:]


def direct_transcription(arm, limits, begin, end, nodes=50, rounds=60):
    """The least time from posture to posture [s], by sequential linear programming.

    The joints' angles at evenly spaced nodes, and the time T, are chosen. Over the share of the
    time, with central differences q' and q'', rates are within v T, accelerations within a T^2,
    and torques, quadratic in q', within the limits' times T^2.
    """
    n, ds, floating = arm.n, 1.0 / nodes, Floating(arm)
    x = np.linspace(0.0, 1.0, nodes + 1)[:, None]
    q = begin + x**2 * (3 - 2 * x) * (end - begin)
    T, trust = 3.0 * max(np.abs(end - begin).max(), 1.0), 0.2
    inner = np.arange(1, nodes)

    def differences(q):
        padded = np.vstack([q[1:2], q, q[-2:-1]])  # at rest, from where it came
        return (padded[2:] - padded[:-2]) / (2 * ds), np.diff(padded, 2, axis=0) / ds**2

    def loads(q, T):
        qd, qdd = differences(q)
        return np.array([floating.torques(*one) for one in zip(q, qd, qdd, strict=True)])

    def worst(q, T):
        qd, qdd = differences(q)
        tau = loads(q, T) / T**2 + limits.viscous * qd / T
        between = np.diff(q, axis=0) / ds / T
        return max(
            np.abs(between / limits.rate).max(),
            np.sqrt(np.abs(qdd / T**2 / limits.acceleration).max()),
            np.abs(tau / limits.torque).max() ** 0.5,
        )

    def reflected(blocks):
        for ghost, inside in ((-1, 1), (nodes + 1, nodes - 1)):
            if ghost in blocks:
                blocks[inside] = blocks[inside] + blocks.pop(ghost)
        return blocks

    best = np.inf
    T *= max(1.0, worst(q, T))
    for _ in range(rounds):
        size = n * len(inner) + 1
        qd, qdd = differences(q)
        tau, rows, low_high = loads(q, T), [], []
        for k in range(nodes + 1):
            # By the angles at k - 1, k, k + 1: torque of q, q', q'' at node k.
            by = np.zeros((3, n, n))
            for i in range(n):
                d = 1e-6 * np.eye(n)[i]
                by[0, :, i] = (floating.torques(q[k] + d, qd[k], qdd[k]) - tau[k]) / 1e-6
                by[1, :, i] = (floating.torques(q[k], qd[k] + d, qdd[k]) - tau[k]) / 1e-6
                by[2, :, i] = floating.torques(q[k], 0 * d, np.eye(n)[i])
            by[1] += limits.viscous * T * np.eye(n)
            near = {
                k - 1: by[2] / ds**2 - by[1] / (2 * ds),
                k: by[0] - 2 * by[2] / ds**2,
                k + 1: by[2] / ds**2 + by[1] / (2 * ds),
            }
            near = reflected(near)
            load = tau[k] + limits.viscous * T * qd[k]
            rows.append((near, limits.viscous * qd[k]))
            low_high.append((load, limits.torque * T**2, 2 * T * limits.torque))
            eye = np.eye(n)
            second = {k - 1: eye / ds**2, k: -2 * eye / ds**2, k + 1: eye / ds**2}
            rows.append((reflected(second), np.zeros(n)))
            low_high.append((qdd[k], limits.acceleration * T**2, 2 * T * limits.acceleration))
            if k < nodes:
                rows.append(({k: -eye / ds, k + 1: eye / ds}, np.zeros(n)))
                low_high.append(((q[k + 1] - q[k]) / ds, limits.rate * T, limits.rate))
        A = lil_matrix((2 * n * len(rows), size))
        b = np.empty(2 * n * len(rows))
        for r, ((near, by_T), (value, most, most_by_T)) in enumerate(
            zip(rows, low_high, strict=True)
        ):
            at = 2 * n * r
            for k, block in near.items():
                if 1 <= k < nodes:
                    A[at : at + n, n * (k - 1) : n * k] = block
                    A[at + n : at + 2 * n, n * (k - 1) : n * k] = -block
            A[at : at + n, size - 1] = (by_T - most_by_T)[:, None]
            A[at + n : at + 2 * n, size - 1] = (-by_T - most_by_T)[:, None]
            b[at : at + n], b[at + n : at + 2 * n] = most - value, most + value
        span = limits.bounds[None] - q[inner][..., None]
        ranges = np.stack([span[..., 0].clip(-trust), span[..., 1].clip(None, trust)], axis=-1)
        ranges = [*map(tuple, ranges.reshape(-1, 2)), (-0.3 * T, 0.1 * T)]
        cost = np.append(np.zeros(size - 1), 1.0)
        step = linprog(cost, A_ub=A.tocsr(), b_ub=b, bounds=ranges, method="highs")
        if not step.success:
            trust *= 0.5
            continue
        new = q.copy()
        new[inner] += step.x[:-1].reshape(-1, n)
        # As slow as what linearization left out needs.
        T_new = T + step.x[-1]
        for _ in range(20):
            T_new *= max(1.0, worst(new, T_new) * (1 - 1e-9))
        if T_new < T - 1e-9:
            gain = T - T_new
            q, T = new, T_new
            best = min(best, T)
            if gain < 1e-4 * T:
                trust *= 0.5
        else:
            trust *= 0.5
        if trust < 1e-3:
            break
    return best
