"""Speed of the dynamics, compared with MuJoCo and Pinocchio (python bench/bench_plant.py [beds]).

Also the speed of the bed, in multiples of real time, with several vehicles, contact and grips;
`beds`: only that. It fails if bodies that touch are slower than MIN_TOUCHING_SPEED.

RK4 at 1 ms; the whole trajectory is stored. Each figure is the median over interleaved runs, so
that other load affects all programs equally; ratios are medians of the ratios of the runs. The
share of peak refers to the multiplications and additions that one core can make in registers,
measured in the same run; the operations of a step are counted in fss_arm_model.lanes.
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
from model_oracles import mujoco_index, mujoco_model, mujoco_xml, pinocchio_model
from peak import PEAK_OPERATIONS, multiply_and_add

from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target
from fss_arm_model.integration import STEP
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.rollout import rollout
from fss_sim.plant.bed import Bed
from fss_sim.plant.contact import Contact
from fss_sim.plant.drives import MODE_CURRENT, MODE_VELOCITY
from fss_sim.plant.joints import PRESETS
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper, PassiveTarget
from fss_sim.plant.vehicle import Demand, Vehicle, World

STEPS, RUNS = 5000, 15
MIN_TOUCHING_SPEED = 50.0  # times real time
WIDE = Surroundings(table=(40.0, 40.0))  # the border is far away
FORCES = mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


def elapsed(run):
    start = perf_counter()
    run()
    return perf_counter() - start


def in_mujoco(arm, tau, threads=1):
    """Return a function that rolls out each tau (rollouts, steps, 3 + n)."""
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
    """Return a function that makes a rollout by `aba` in a Runge-Kutta loop in Python."""
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
    runs = [(elapsed(peer), elapsed(ours), elapsed(multiply_and_add)) for _ in range(RUNS)]
    times = np.array(runs) / (peer_steps, our_steps, PEAK_OPERATIONS)
    peer_time, our_time, _ = 1e6 * np.median(times, axis=0)
    ratio = np.median(times[:, 0] / times[:, 1])
    share = np.median(operations(n) * times[:, 2] / times[:, 1]) / threads
    print(
        f"{name:34} {our_time:8.3f} us/step  peer {peer_time:8.3f} us/step  ratio {ratio:5.1f}"
        f"  (at least {required}), {100.0 * share:.0f}% of peak"
    )


def operations(n):
    """Return the operations of a step: per body and stage 31 + 100 + 8; others for the origin."""
    bodies = n + 1
    return 4 * (139 * bodies + 40) + 43 * bodies + 20


def compare_rollouts(arm, rng, required, required_of_batch):
    """Compare one rollout and many with the peers; `required` is the least ratio to MuJoCo."""
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
        peer, run_ours = in_mujoco(arm, many[: 64 * threads], threads), partial(ours_many, threads)
        share = steps * threads // cores
        compare("mujoco.rollout", peer, run_ours, share, share, required_of_batch, n, threads)


def vehicles(number, gripper=None, preset="default"):
    """Return vehicles 3 m apart that move their joints."""
    made, joints = [], PRESETS[preset]
    for k in range(number):
        world = World(joints, WIDE, gripper=gripper or Gripper())
        made.append(Vehicle(paper_arm(), [3.0 * k, 0.0, 0.0, 0, 0, 0, 0], None, world, name=f"{k}"))
        for joint, rate in enumerate((0.1, -0.1, 0.1, 0.1)):
            made[-1].command(joint, Demand(MODE_VELOCITY, rate, abs(rate), 1.0))
    return made


def separate_bed(number, targets, contact, preset="default"):
    """Return a bed whose bodies are far from each other."""
    free = [PassiveTarget(Target(), [[3.0 * k, 5.0, 0.0], 3 * [0.0]], WIDE) for k in range(targets)]
    return Bed(vehicles(number, preset=preset), free, contact)


def pressed_centre():
    """Return the centre of a disc that just touches the middle of the third link."""
    a, b = (complex(*at) for at in joint_positions(paper_arm().vector(), np.zeros(7))[2:4])
    return 0.5 * (a + b) + 1j * (b - a) / abs(b - a) * 0.251


def leaning_bed():
    """Return a bed with an arm whose third link presses on a heavy target."""
    (one,), c = vehicles(1), pressed_centre()
    one.command(0, Demand(MODE_CURRENT, 1.5))
    target = PassiveTarget(Target(500.0, 9.0), [[c.real, c.imag, 0], 3 * [0.0]], WIDE)
    return Bed([one], [target], Contact())


def holding_bed(gripper, with_target=False):
    """Return a bed with two arms that hold each other, or one target: a closed chain."""
    made = vehicles(2, gripper)
    for vehicle in made:
        vehicle.closed = True
    target = PassiveTarget(Target(radius=0.01), [[1.5, 1.0, 0.0], 3 * [0.0]], WIDE)
    return Bed(made, [target] if with_target else [], Contact())


def pushing_bed():
    """Return a bed with two vehicles whose bases bump, and one pushes the other."""
    made = vehicles(2)
    made[0]._state[0, 2], made[1]._state[0, 0] = np.pi, 0.381
    made[0]._state[1, 0] = 0.01
    made[0].thrusters.set_stuck(made[0].thrusters.layout[:, 0] < 0.0, [False] * 8)
    return Bed(made, [], Contact())


def touching_peer(weld):
    """Return MuJoCo's frame of 10 ms of the leaning arm, or of two arms that hold each other."""
    kind, c = mujoco.mjtGeom, pressed_centre()
    spec = mujoco.MjSpec.from_string(mujoco_xml(paper_arm()))
    spec.body("base").add_geom(type=kind.mjGEOM_SPHERE, size=[0.19, 0, 0], mass=0)
    for i, link in enumerate(paper_arm().links, 1):
        line = [0, 0, 0, link.a, 0, 0]
        spec.body(f"link_{i}").add_geom(
            type=kind.mjGEOM_CAPSULE, size=[0.06, 0, 0], fromto=line, mass=0
        )
    if weld:
        other = mujoco.MjSpec.from_string(spec.to_xml())
        spec.attach(other, prefix="other_", frame=spec.worldbody.add_frame(pos=[3.0, 0, 0]))
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="link_4",
            name2="other_link_4",
        )
    else:
        disc = spec.worldbody.add_body(name="target", pos=[c.real, c.imag, 0])
        disc.mass, disc.inertia, disc.explicitinertial = 500.0, [9.0, 9.0, 9.0], True
        for axis in np.eye(2, 3):
            disc.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        disc.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        disc.add_geom(type=kind.mjGEOM_SPHERE, size=[0.19, 0, 0], mass=0)
    model = spec.compile()
    model.opt.timestep, data = STEP, mujoco.MjData(model)
    joints = mujoco_index(model, "q", 4)
    model.dof_damping[joints], model.dof_frictionloss[joints] = 0.5, 0.3
    model.dof_damping[joints[1:]] += 80.0  # as of a servo
    data.qfrc_applied[joints[0]] = 1.2
    return lambda: mujoco.mj_step(model, data, nstep=10)


def times_real_time(make, time=2.0):
    """Return speed, by processor time in frames of 10 ms, and the share of frames in contact."""
    bed, in_contact = make(), 0
    bed.advance(0.01)
    start = process_time()
    for _ in range(round(100 * time)):
        bed.advance(0.01)
        in_contact += bool(bed.contact_impulses)
    return time / (process_time() - start), in_contact / (100 * time)


def measure_beds():
    """Print the speed of beds in multiples of real time; return that of the slowest that touch."""
    print("the bed, in multiples of real time (one thread)")
    for name, make in {
        "one vehicle": lambda: separate_bed(1, 0, None),
        "one vehicle, a target, contact": lambda: separate_bed(1, 1, Contact()),
        "two vehicles, a target, contact": lambda: separate_bed(2, 1, Contact()),
        "the same, flexible joints": lambda: separate_bed(2, 1, Contact(), "laboratory"),
        "four vehicles, two targets, contact": lambda: separate_bed(4, 2, Contact()),
    }.items():
        print(f"  {name:36} {np.median([times_real_time(make)[0] for _ in range(4)]):8.1f}")
    wide, limited = Gripper(5.0, 3.2, 5.0), Gripper(5.0, 3.2, 5.0, force=500.0, torque=500.0)
    slowest = np.inf
    for name, make, weld in (
        ("an arm leans on a target", leaning_bed, False),
        ("a vehicle bumps and pushes another", pushing_bed, None),
        ("two arms hold each other", lambda: holding_bed(wide), True),
        ("two arms hold a target", lambda: holding_bed(wide, True), None),
        ("the same, with limits", lambda: holding_bed(limited, True), None),
    ):
        rows, ratios = [], []
        for _ in range(4):
            rows.append(times_real_time(make))
            if weld is not None:
                frame = touching_peer(weld)
                start = process_time()
                for _ in range(200):
                    frame()
                ratios.append(rows[-1][0] * (process_time() - start) / 2.0)
        speed, share = np.median(rows, axis=0)
        peer = f", {np.median(ratios):.1f} times as fast as MuJoCo" if ratios else ""
        print(f"  {name:36} {speed:8.1f}, contact in {100 * share:.0f} of 100 frames{peer}")
        slowest = min(slowest, speed)
    return slowest


def with_gears(arm, joints, has_friction):
    """Compare the plant with flexible joints with MuJoCo with motors on springs.

    With friction, MuJoCo has the dry and viscous friction of the motors, and the joint limits as
    constraints; the plant also has Stribeck's curve, ripple and current loops. The plant audits
    momentum and energy in both cases.
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
        plant = Plant(arm, np.zeros(3 + arm.n), world=World(joints, WIDE, contact=None))
        for joint, link in enumerate(arm.links):
            plant.command(joint, Demand(MODE_CURRENT, torques[joint] / link.drive.torque_constant))
        plant.advance(STEPS * STEP)

    ours()  # compiled
    runs = [(elapsed(peer), elapsed(ours)) for _ in range(RUNS)]
    peer_time, our_time = 1e6 / STEPS * np.median(runs, axis=0)
    ratio = np.median([peer_run / our_run for peer_run, our_run in runs])
    label = "with friction and limits, at least 5" if has_friction else "springs and dampers alone"
    print(
        f"  {our_time:6.3f} us/step  mujoco {peer_time:7.3f} us/step  ratio {ratio:5.1f}  ({label})"
    )


def main():
    if sys.argv[1:] == ["beds"]:
        return int(measure_beds() < MIN_TOUCHING_SPEED)
    rng = np.random.default_rng(1)
    multiply_and_add()  # compiled
    compare_rollouts(paper_arm(), rng, 8, 25)
    compare_rollouts(random_arm(12, rng), rng, 15, 25)
    print("flexible joints, 4 links, the plant with drives and audit, one thread")
    with_gears(paper_arm(), PRESETS["laboratory"], True)
    with_gears(paper_arm(), PRESETS["laboratory"], False)
    print("cost of a step by the number of links (one thread)")
    for n in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32):
        links = [random_arm(2, rng).vector()[14:] for _ in range(n - 1)]
        chain, rest = np.concatenate([random_arm(1, rng).vector(), *links]), np.zeros(3 + n)
        none = np.zeros((2000, 3 + n))
        times = [elapsed(partial(rollout, chain, rest, rest, none)) for _ in range(RUNS)]
        print(f"  n = {n:2}  {1e6 * np.median(times) / 2000:8.3f} us")
    return int(measure_beds() < MIN_TOUCHING_SPEED)


if __name__ == "__main__":
    sys.exit(main())
