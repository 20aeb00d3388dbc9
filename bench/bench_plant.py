"""Speed of the dynamics beside that of MuJoCo and Pinocchio (python bench/bench_plant.py).

RK4 at 1 ms, the whole trajectory kept. Each figure is the median over interleaved runs, so that
what else the machine does touches all alike; ratios are medians of the runs' own ratios.
"""

import os
import sys
from pathlib import Path
from time import perf_counter

import mujoco
import numpy as np
import pinocchio as pin
from mujoco import rollout as mujoco_rollout

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from model_arms import random_arm
from model_oracles import mujoco_model, pinocchio_model

from fss_arm_model.description import paper_arm
from fss_arm_model.integration import STEP
from fss_arm_model.rollout import rollout

STEPS, RUNS = 5000, 15
FORCES = mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


def seconds(run):
    begin = perf_counter()
    run()
    return perf_counter() - begin


def in_mujoco(arm, tau, threads=1):
    """A rollout of each tau (rollouts, steps, 3 + n), with all that the arm has no use for off."""
    model = mujoco_model(arm)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, STEP
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONSTRAINT.value | off.mjDSBL_CONTACT.value
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros((len(tau), size))
    data = [mujoco.MjData(model) for _ in range(threads)]
    if threads == 1:
        return lambda: mujoco_rollout.rollout(model, data[0], state, tau, control_spec=FORCES)
    pool = mujoco_rollout.Rollout(nthread=threads)
    return lambda: pool.rollout(model, data, state, tau, control_spec=FORCES)


def in_pinocchio(arm, tau):
    """One rollout by `aba` in a Runge-Kutta loop in Python."""
    model = pinocchio_model(arm)
    data = model.createData()

    def run():
        q, v = np.zeros((2, model.nv))
        for t in tau:
            a1 = pin.aba(model, data, q, v, t)
            v2 = v + 0.5 * STEP * a1
            a2 = pin.aba(model, data, q + 0.5 * STEP * v, v2, t)
            v3 = v + 0.5 * STEP * a2
            a3 = pin.aba(model, data, q + 0.5 * STEP * v2, v3, t)
            v4 = v + STEP * a3
            a4 = pin.aba(model, data, q + STEP * v3, v4, t)
            q = q + STEP / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + STEP / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

    return run


def compare(name, peer, ours, peer_steps, our_steps, required):
    times = np.array([[seconds(peer) / peer_steps, seconds(ours) / our_steps] for _ in range(RUNS)])
    theirs, mine = 1e6 * np.median(times, axis=0)
    ratio = np.median(times[:, 0] / times[:, 1])
    print(
        f"{name:34} {mine:8.3f} us/step  peer {theirs:8.3f} us/step  ratio {ratio:5.1f}"
        f"  (at least {required})"
    )


def main():
    arm, rng = paper_arm(), np.random.default_rng(1)
    p, rest = arm.vector(), np.zeros(3 + arm.n)
    tau = np.zeros((STEPS, 3 + arm.n))
    tau[:, 3:] = 0.1 * rng.standard_normal(arm.n)
    rollout(p, rest, rest, tau[:1])  # compiled

    def ours():
        rollout(p, rest, rest, tau)

    print(f"four links, one rollout of {STEPS} steps, one thread, {RUNS} runs")
    compare("mujoco.rollout", in_mujoco(arm, tau[None]), ours, STEPS, STEPS, 7)
    compare("pinocchio.aba, RK4 in Python", in_pinocchio(arm, tau[:500]), ours, 500, STEPS, 15)

    cores = os.cpu_count() or 1
    many = np.broadcast_to(tau[:500], (32 * cores, 500, 3 + arm.n)).copy()

    def ours_in_parallel():
        rollout(p, rest, rest, many, threads=cores)

    steps = many.shape[0] * many.shape[1]
    print(f"{many.shape[0]} rollouts of 500 steps over {cores} threads")
    compare("mujoco.rollout", in_mujoco(arm, many, cores), ours_in_parallel, steps, steps, 5)

    print("cost of a step by the number of links (one thread)")
    for n in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32):
        links = [random_arm(2, rng).vector()[14:] for _ in range(n - 1)]
        chain, still = np.concatenate([random_arm(1, rng).vector(), *links]), np.zeros(3 + n)
        none = np.zeros((2000, 3 + n))
        took = [seconds(lambda: rollout(chain, still, still, none)) for _ in range(RUNS)]  # noqa: B023
        print(f"  n = {n:2}  {1e6 * np.median(took) / 2000:8.3f} us")


if __name__ == "__main__":
    main()
