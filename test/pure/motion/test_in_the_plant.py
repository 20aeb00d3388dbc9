"""Plans run on the simulated test bed's plant: drives with friction, links as in the protocol.

Each link follows its path by itself, 50 times a second, in velocity mode: v = v_path + 4/s (p_path
- p), with v_path of the middle of the period. (With v_path of its start, links lag where they
accelerate, all to one side, and the reorientation ends 0.37 deg off instead of 0.12.) The true arm
is not the one planned for: masses, inertias and centers of mass differ as the covariance says. The
links do not start at exactly the same time.
"""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_motion.plan import Start
from fss_arm_motion.plan_command import relative_covariance
from fss_arm_motion.reorientation import Reorientation, reorientation
from fss_arm_motion.tip_path import TipPath, tip_path
from fss_arm_motion.zero_reaction import ZeroReaction, zero_reaction
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand

SHARE = 0.01  # 1 sigma of masses, inertias and centres of mass
PERIOD, GAIN = 0.02, 4.0  # of a link [s], [1/s]
SPREAD = 0.005  # of the links' start times [s]
TRACKING = np.radians(0.1)  # by which links differ from their paths, rms
BENT = np.radians([-50.0, 55.0, 45.0, 40.0])


def drawn(arm, rng):
    """An arm as far from the description as that may be."""

    def off(value):
        return value * (1.0 + SHARE * rng.standard_normal())

    links = tuple(
        replace(k, mass=off(k.mass), inertia=off(k.inertia), b=k.a - off(k.g)) for k in arm.links
    )
    base = replace(arm.base, mass=off(arm.base.mass), inertia=off(arm.base.inertia))
    return replace(arm, base=base, links=links)


def run(plan, arm, rng):
    """Times, states of the plant (3 + n,), and its tip in the world."""
    bed = Plant(arm, np.concatenate([plan.prediction.pose[0], plan.q[0]]))
    late = SPREAD * np.abs(rng.standard_normal(arm.n))
    times, states = [], []
    for k in range(int((plan.duration + 1.5) / PERIOD)):
        for i in range(arm.n):
            t = np.clip(k * PERIOD - late[i], 0.0, plan.duration)
            ahead = min(t + 0.5 * PERIOD, plan.duration)
            (q, _), (_, qd) = (x[:, i] for x in plan.at(np.array([t, ahead])))
            rate = qd + GAIN * (q - bed.q[3 + i])
            bed.command(i, Demand(MODE_VELOCITY, float(rate), abs(float(rate)), 2.0))
        bed.advance(PERIOD)
        times.append((k + 1) * PERIOD)
        states.append(bed.q.copy())
    return np.array(times), np.array(states)


def start_motion(q):
    arm = paper_arm()
    return Start(arm, q, covariance=relative_covariance(arm, SHARE), tracking=TRACKING)


@pytest.mark.parametrize("runs", [6, pytest.param(20, marks=pytest.mark.slow)])
def test_reorientation_ends_within_its_band_each_time(runs):
    start = start_motion(np.zeros(4))
    plan = reorientation(start, Reorientation(np.radians(30.0)))
    sigma = np.degrees(plan.prediction.deviation[-1, 2])
    ends = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        states = run(plan, drawn(start.arm, rng), rng)[1]
        ends.append(np.degrees(states[-1, 2]))
    errors = np.array(ends) - np.degrees(plan.prediction.pose[-1, 2])
    print(f"turn {np.mean(ends):.3f} deg, errors {errors.round(3)} deg, 1 sigma {sigma:.3f} deg")
    assert np.abs(errors).max() < 3.0 * sigma
    assert 0.3 * sigma < errors.std() < 2.0 * sigma


@pytest.mark.parametrize("seed", range(3))
def test_zero_reaction_turns_the_base_far_less_than_the_straight_move(seed):
    start, rng = start_motion(BENT), np.random.default_rng(seed)
    plan = zero_reaction(start, ZeroReaction(direction=(1.0, 0.0, 0.0, 0.0)))
    states = run(plan, drawn(start.arm, rng), rng)[1]
    excursion = np.degrees(np.abs(states[:, 2]).max())
    print(f"excursion {excursion:.3f} deg")
    assert excursion < 0.5


def test_on_the_arm_as_described_zero_reaction_holds_the_heading_to_a_tenth_of_a_degree():
    start, rng = start_motion(BENT), np.random.default_rng(0)
    plan = zero_reaction(start, ZeroReaction(direction=(1.0, 0.0, 0.0, 0.0)))
    states = run(plan, start.arm, rng)[1]
    print(f"excursion {np.degrees(np.abs(states[:, 2]).max()):.4f} deg")
    assert np.degrees(np.abs(states[:, 2]).max()) < 0.1


@pytest.mark.parametrize("drawn_too", [False, True])
def test_half_a_metre_in_the_world(drawn_too):
    from fss_arm_model.kinematics import tip_pose

    start, rng = start_motion(BENT), np.random.default_rng(1)
    by = 0.5 * np.array([np.cos(3.7), np.sin(3.7)])
    plan = tip_path(start, TipPath(by=tuple(by)))
    arm = drawn(start.arm, rng) if drawn_too else start.arm
    states = run(plan, arm, rng)[1]
    tip = tip_pose(arm.vector(), states)[:, :2]
    first = tip_pose(arm.vector(), np.concatenate([np.zeros(3), BENT]))[:2]
    across = np.abs((tip - first) @ [-by[1], by[0]]) / 0.5
    short = np.linalg.norm(tip[-1] - first - by)
    print(f"off the line {1e3 * across.max():.2f} mm, at the end {1e3 * short:.2f} mm")
    assert across.max() < (10e-3 if drawn_too else 3e-3)
    assert short < (10e-3 if drawn_too else 3e-3)
