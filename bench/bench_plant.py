"""Speed of the dynamics beside that of MuJoCo and Pinocchio (python bench/bench_plant.py [beds]).

And how many times as fast as real time the bed is with several vehicles, contact and grips; `beds`:
that alone.

RK4 at 1 ms, the whole trajectory kept. Each figure is the median over interleaved runs, so that
what else the machine does touches all alike; ratios are medians of the runs' own ratios. The share
of peak is that of the multiplications and additions that one core makes in the same run, in
registers and without waiting; those of a step are counted from fss_arm_model.lanes.
"""

import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter, process_time

import mujoco
import numpy as np
import pinocchio as pin
from mujoco import rollout as mujoco_rollout

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from model_arms import random_arm
from model_oracles import mujoco_index, mujoco_model, pinocchio_model
from peak import PEAK_OPERATIONS, multiply_and_add

from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target
from fss_arm_model.integration import STEP
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.rollout import rollout
from fss_sim.plant.bed import Bed
from fss_sim.plant.contact import Contact
from fss_sim.plant.drives import CURRENT, VELOCITY
from fss_sim.plant.joints import PRESETS
from fss_sim.plant.plant import Demand, Plant, Vehicle, World
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper, Passive

STEPS, RUNS = 5000, 15
WIDE = Surroundings(table=(40.0, 40.0))  # no border near
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


def compare(name, peer, ours, peer_steps, our_steps, required, n=4, threads=1):
    runs = [(seconds(peer), seconds(ours), seconds(multiply_and_add)) for _ in range(RUNS)]
    times = np.array(runs) / (peer_steps, our_steps, PEAK_OPERATIONS)
    theirs, mine, _ = 1e6 * np.median(times, axis=0)
    ratio = np.median(times[:, 0] / times[:, 1])
    share = np.median(operations(n) * times[:, 2] / times[:, 1]) / threads
    print(
        f"{name:34} {mine:8.3f} us/step  peer {theirs:8.3f} us/step  ratio {ratio:5.1f}"
        f"  (at least {required}), {100.0 * share:.0f}% of peak"
    )


def operations(n):
    """Of a step: by body in a stage turning 31, rate 100, sums 8; beside, turning and origin."""
    bodies = n + 1
    return 4 * (139 * bodies + 40) + 43 * bodies + 20


def beside_peers(arm, rng, required, required_of_batch):
    """One rollout, and many; at least so many times as fast as MuJoCo."""
    p, rest, n = arm.vector(), np.zeros(3 + arm.n), arm.n
    tau = np.zeros((STEPS, 3 + n))
    tau[:, 3:] = 0.1 * rng.standard_normal(n)
    cores = os.cpu_count() or 1
    many = np.broadcast_to(tau[:500], (64 * cores, 500, 3 + n)).copy()
    steps = many.shape[0] * many.shape[1]

    def ours():
        return rollout(p, rest, rest, tau)

    def ours_many(threads=1):
        return rollout(p, rest, rest, many[: 64 * threads], threads=threads)

    ours()  # compiled
    ours_many()
    print(f"{n} links, one rollout of {STEPS} steps, one thread, {RUNS} runs")
    compare("mujoco.rollout", in_mujoco(arm, tau[None]), ours, STEPS, STEPS, required, n)
    compare("pinocchio.aba, RK4 in Python", in_pinocchio(arm, tau[:500]), ours, 500, STEPS, 15, n)
    for threads in sorted({1, cores}):
        print(f"{n} links, {64 * threads} rollouts of 500 steps over {threads} threads")
        peer, mine = in_mujoco(arm, many[: 64 * threads], threads), partial(ours_many, threads)
        share = steps * threads // cores
        compare("mujoco.rollout", peer, mine, share, share, required_of_batch, n, threads)


def vehicles(number, gripper=None, preset="default"):
    """Vehicles 3 m apart, each driving its joints."""
    found, joints = [], PRESETS[preset]
    for k in range(number):
        world = World(joints, WIDE, gripper=gripper or Gripper())
        found.append(
            Vehicle(paper_arm(), [3.0 * k, 0.0, 0.0, 0, 0, 0, 0], None, world, name=f"{k}")
        )
        for joint, rate in enumerate((0.1, -0.1, 0.1, 0.1)):
            found[-1].command(joint, Demand(VELOCITY, rate, abs(rate), 1.0))
    return found


def apart(number, targets, contact, preset="default"):
    """None near another."""
    free = [Passive(Target(), [[3.0 * k, 5.0, 0.0], 3 * [0.0]], WIDE) for k in range(targets)]
    return Bed(vehicles(number, preset=preset), free, contact)


def leaning():
    """An arm whose third link leans on a heavy target."""
    (one,) = vehicles(1)
    a, b = (complex(*at) for at in joint_positions(one.p, one.q)[2:4])
    c = 0.5 * (a + b) + 1j * (b - a) / abs(b - a) * 0.251
    one.command(0, Demand(CURRENT, 1.5))
    return Bed(
        [one], [Passive(Target(500.0, 9.0), [[c.real, c.imag, 0], 3 * [0.0]], WIDE)], Contact()
    )


def arm_in_arm():
    """Two that hold each other: a closed chain."""
    one, other = vehicles(2, Gripper(5.0, 3.2, 5.0))
    one.closed = True
    return Bed([one, other], [], Contact())


def beds(time=2.0):
    """How many times as fast as real time the bed is, by the processor's time; frames of 10 ms."""
    cases = {
        "one vehicle": lambda: apart(1, 0, None),
        "one vehicle, a target, contact": lambda: apart(1, 1, Contact()),
        "two vehicles, a target, contact": lambda: apart(2, 1, Contact()),
        "the same, joints that give": lambda: apart(2, 1, Contact(), "laboratory"),
        "four vehicles, two targets, contact": lambda: apart(4, 2, Contact()),
        "one leans on a target": leaning,
        "two arm in arm": arm_in_arm,
    }
    print("the bed, in multiples of real time (one thread)")
    for name, make in cases.items():
        rows = []
        for _ in range(4):
            bed, touched = make(), 0
            bed.advance(0.01)
            begin = process_time()
            for _ in range(round(100 * time)):
                bed.advance(0.01)
                touched += bool(bed.touched)
            rows.append(time / (process_time() - begin))
        print(f"  {name:36} {np.median(rows):8.1f}  touched in {touched / time:.0f} frames of 100")


def with_gears(arm, joints, has_friction):
    """The plant with joints that give, beside MuJoCo with motors on springs, driven alike.

    With friction, MuJoCo has that of the motors, dry and viscous, and the joints' limits as its
    constraints; the plant beside has Stribeck's curve, ripple and current loops. It keeps its books
    in both cases.
    """
    torques = 0.5 * np.resize([1.0, -1.0], arm.n)
    if not has_friction:
        joints = replace(
            joints, viscous=0.0, coulomb=0.0, static=0.0, dead_band=0.0, ripple=0.0,
            current_bandwidth=0.0, stop_stiffness=0.0, stop_damping=0.0,
        )  # fmt: skip
    model, N = mujoco_model(arm, joints), joints.gear_ratio
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, STEP
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT.value
    motors = mujoco_index(model, "m", arm.n)
    if has_friction:
        model.dof_frictionloss[motors] = joints.coulomb / N
        model.dof_damping[motors] = joints.viscous / N**2
        limited = mujoco_index(model, "q", arm.n)
        model.jnt_limited[limited] = 1
        model.jnt_range[limited] = [(link.q_min, link.q_max) for link in arm.links]
    else:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    state = np.zeros((1, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    tau, data = np.zeros((1, STEPS, model.nv)), mujoco.MjData(model)
    tau[0, :, motors] = torques[:, None] / N

    def peer():
        mujoco_rollout.rollout(model, data, state, tau, control_spec=FORCES)

    def ours():
        plant = Plant(arm, np.zeros(3 + arm.n), world=World(joints, WIDE))
        for joint, link in enumerate(arm.links):
            plant.command(joint, Demand(CURRENT, torques[joint] / link.drive.torque_constant))
        plant.advance(STEPS * STEP)

    ours()  # compiled
    runs = [(seconds(peer), seconds(ours)) for _ in range(RUNS)]
    theirs, mine = 1e6 / STEPS * np.median(runs, axis=0)
    ratio = np.median([peer / own for peer, own in runs])
    words = "with friction and limits, at least 5" if has_friction else "springs and dampers alone"
    print(f"  {mine:6.3f} us/step  mujoco {theirs:7.3f} us/step  ratio {ratio:5.1f}  ({words})")


def main():
    if sys.argv[1:] == ["beds"]:
        beds()
        return
    rng = np.random.default_rng(1)
    multiply_and_add()  # compiled
    beside_peers(paper_arm(), rng, 8, 25)
    beside_peers(random_arm(12, rng), rng, 15, 25)
    print("joints that give, 4 links, the plant with drives, books and all, one thread")
    with_gears(paper_arm(), PRESETS["laboratory"], True)
    with_gears(paper_arm(), PRESETS["laboratory"], False)
    print("cost of a step by the number of links (one thread)")
    for n in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32):
        links = [random_arm(2, rng).vector()[14:] for _ in range(n - 1)]
        chain, still = np.concatenate([random_arm(1, rng).vector(), *links]), np.zeros(3 + n)
        none = np.zeros((2000, 3 + n))
        took = [seconds(partial(rollout, chain, still, still, none)) for _ in range(RUNS)]
        print(f"  n = {n:2}  {1e6 * np.median(took) / 2000:8.3f} us")
    beds()


if __name__ == "__main__":
    main()
