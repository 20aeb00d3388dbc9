"""Oracles of plans: MuJoCo in open loop, and their limits between the knots."""

from itertools import pairwise

import mujoco
import numpy as np
from model_oracles import mujoco_model

from fss_arm_model.free_floating import free_torques
from fss_arm_motion.plan import probed


def open_loop(start, plan, step=5e-4):
    """Times, states and momenta (P, L about the centre of mass) that the plan's torques give.

    Nothing holds the joints to their paths: what differs adds up.
    """
    model = mujoco_model(start.arm)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data, n = mujoco.MjData(model), start.arm.n
    data.qpos[:] = np.concatenate([start.pose, start.q])
    times, states, momenta = [], [], []
    body = model.body("base").id
    for begin, end in pairwise(plan.times):
        steps = int(np.ceil((end - begin) / step))  # accelerations may jump at knots
        model.opt.timestep = (end - begin) / steps
        for k in range(steps):
            q, qd, qdd = motion(plan, begin + (k + 0.5) * model.opt.timestep)
            tau, _ = free_torques(start.arm.vector(), q, qd, qdd, 0.0)
            data.qfrc_applied[:] = np.concatenate([np.zeros(3), tau])
            mujoco.mj_step(model, data)
            mujoco.mj_subtreeVel(model, data)
            times.append(begin + (k + 1) * model.opt.timestep)
            states.append(data.qpos.copy())
            P = model.body_subtreemass[body] * data.subtree_linvel[body, :2]
            momenta.append([*P, data.subtree_angmom[body, 2]])
    assert data.qpos.size == 3 + n
    return np.array(times), np.array(states), np.array(momenta)


def motion(plan, t):
    """Angles, rates and accelerations at a time."""
    k = min(np.searchsorted(plan.times, t, "right") - 1, len(plan.times) - 2)
    h, x = plan.times[k + 1] - plan.times[k], t - plan.times[k]
    x /= h
    q0, q1, v0, v1 = plan.q[k], plan.q[k + 1], h * plan.qd[k], h * plan.qd[k + 1]
    b, c = 3 * (q1 - q0) - 2 * v0 - v1, v0 + v1 - 2 * (q1 - q0)
    return (
        q0 + x * (v0 + x * (b + x * c)),
        (v0 + x * (2 * b + 3 * x * c)) / h,
        (2 * b + 6 * x * c) / h**2,
    )


def held(start, plan, count=60):
    """The largest share of limits, the least gap and what is beyond angles, looked at finely."""
    shares, gaps, outside = [], [], ""
    for t in np.linspace(0.0, plan.duration, count * len(plan.times)):
        q, qd, qdd = motion(plan, t)
        shares.append(start.limits.used(start.arm.vector(), q, qd, qdd, start.L))
        gaps.append(float(start.gap(q)))
        outside = outside or start.limits.outside(q)
    edges = start.limits.used(start.arm.vector(), *probed(plan.times, plan.q, plan.qd), start.L)
    return max(np.max(shares), edges.max()), min(gaps), outside
