"""The guidance of the rehearsal, flown on the plant with late and noisy senses."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.thrusters import layout
from fss_sim.guidance import PERIOD, Guidance, Track, pulses
from fss_sim.plant.drives import VELOCITY
from fss_sim.plant.plant import Demand, Plant, World

LATE = 18  # frames that the joints' angles are behind: telemetry at 5 Hz
NOISE = np.array([3e-4, 3e-4, 1e-3])


def fly(heading, seed):
    """The plant and the phases, from a target at this heading that tumbles at 0.15 rad/s."""
    rng, arm, target = np.random.default_rng(seed), paper_arm(), Target()
    q = np.array([-1.0, -0.75, 0.3, 0.9, -1.4, 1.2, -0.6])
    tumbling = [[1.05, 0.75, heading], [-0.012, 0.008, 0.15]]
    bed = Plant(arm, q, None, World(target=target), tumbling)
    guidance, phases, joints, rates = Guidance(arm, target, bed.thrusters.layout), [], [], 4 * [0.0]
    for period in range(600):
        for frame in range(1, 21):
            bed.advance(0.01)
            time = period * PERIOD + 0.01 * frame
            seen = bed.q[:3], tip_pose(arm.vector(), bed.q), bed.target[0]
            tracks = guidance.base, guidance.tip, guidance.body
            for track, pose in zip(tracks, seen, strict=True):
                track.update(time, pose + NOISE * rng.standard_normal(3))
            joints.append((bed.q[3:], bed.qd[3:]))
        angles, moving = joints[-LATE]
        orders = guidance.orders(angles + 0.01 * LATE * moving, moving, bed.holds)
        if orders.phase not in phases:
            phases.append(orders.phase)
        if orders.phase == "done":
            break
        bed.thrust(orders.on_times)
        bed.closed = orders.close
        for joint, rate in enumerate(rates):  # a period late
            bed.command(joint, Demand(VELOCITY, rate, abs(rate), 2.0))
        rates = orders.rates
    return bed, phases


@pytest.mark.parametrize(
    ("heading", "seed"), [(-0.3, 1), pytest.param(1.5, 2, marks=pytest.mark.slow)]
)
def test_it_captures_a_tumbling_target_and_stops_it(heading, seed):
    bed, phases = fly(heading, seed)
    assert phases == ["approach", "reach", "detumble", "done"]
    assert bed.holds
    assert abs(bed.target[1, 2]) < 0.01
    assert np.hypot(*bed.target[1, :2]) < 0.02
    assert bed.clearance > 0.0
    assert np.abs(bed.imbalance).max() < 1e-9


def test_pulses_give_the_wrench_that_is_asked_for():
    rng, thrusters = np.random.default_rng(0), layout(0.16, 0.11)
    for _ in range(20):
        heading, arm = rng.uniform(-3.0, 3.0), complex(*rng.uniform(-0.3, 0.3, 2))
        times = rng.uniform(0.0, 0.5, 8) * PERIOD
        force = (thrusters[:, 0] + 1j * thrusters[:, 1]) * np.exp(1j * heading)
        torque = thrusters[:, 2] + (np.conj(arm) * force).imag
        effect = np.stack([force.real, force.imag, torque])
        wrench = effect @ times / PERIOD
        got = np.array(pulses(thrusters, heading, arm, wrench))
        assert ((got >= 0.0) & (got <= PERIOD)).all()
        np.testing.assert_allclose(effect @ got / PERIOD, wrench, atol=2e-3)


def test_a_track_follows_a_turning_body_beyond_half_a_turn():
    track = Track()
    for k in range(500):
        time = 0.01 * k
        heading = (0.9 * time + np.pi) % (2.0 * np.pi) - np.pi  # as VICON has it
        track.update(time, (0.1 * time, -0.05 * time, heading))
    np.testing.assert_allclose(track.twist, [0.1, -0.05, 0.9], rtol=1e-3)
    np.testing.assert_allclose(track.pose, [0.499, -0.2495, 0.9 * 4.99], rtol=1e-3)
