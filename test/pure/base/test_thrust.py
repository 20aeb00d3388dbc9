"""A valve's thrust from the base's motion: the plant pushes, and the sensors see it."""

import re

import numpy as np
import pytest

from fss_arm_driver.protocol import Mode
from fss_arm_model.description import paper_arm
from fss_arm_model.thrusters import thruster_wrenches
from fss_base_driver.thrust import Body, Thrust, TrackError, estimate, valve_order, verdict
from fss_sim.noise import PRESETS
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.vehicle import Demand, World
from fss_sim.sensors import RATE, Sensors

VALVES = thruster_wrenches(0.16, 0.11)
Q = (0.3, -0.5, 0.7, 0.2)
ARM = paper_arm()
TIME_BEFORE, TIME_AFTER, ON_TIME = 3.0, 4.0, 1.0


def fly(
    valve, preset="default", seed=1, heading=0.9, tilt=(0.0, 0.0), drift=(0.004, -0.003, 0.002)
):
    """Poses and rates of the base, one valve open for ON s after BEFORE."""
    world = World(surroundings=Surroundings(tilt=tilt))
    plant = Plant(ARM, (0.5, 0.2, heading, *Q), (*drift, 0, 0, 0, 0), world)
    for i in range(ARM.n):  # each joint holds its place
        plant.command(i, Demand(Mode.POSITION, 0.0, 0.0, 5.0))
    sensors, poses, rates = Sensors(PRESETS[preset], seed), [], []
    for k in range(round((TIME_BEFORE + ON_TIME + TIME_AFTER) * RATE)):
        if k == round(TIME_BEFORE * RATE):
            plant.thrust([ON_TIME if i == valve else 0.0 for i in range(8)])
        plant.advance(1.0 / RATE)
        sight = sensors.observe(k, plant.base, plant.tip, float(plant.qd[2]), plant.qd[3:])
        poses.append(((k + 1) / RATE, *sight.base.pose))
        rates.append(((k + 1) / RATE, sight.rate))
    return poses, rates


@pytest.mark.parametrize("valve", [0, 5])
def test_without_noise_it_is_the_thrusters_own(valve):
    poses, rates = fly(valve, "ideal")
    found = estimate(Body.of(ARM, Q), poses, rates, TIME_BEFORE + 0.005, ON_TIME)
    np.testing.assert_allclose(found.force, VALVES[valve, :2], atol=0.004)
    assert found.torque == pytest.approx(VALVES[valve, 2], abs=0.0015)
    assert verdict(found, VALVES, valve) == ""


def test_with_default_errors_on_a_tilted_table_its_deviation_is_honest():
    body, off = Body.of(ARM, Q), []
    for seed in range(8):
        valve = seed
        found = estimate(body, *fly(valve, seed=seed, tilt=(1e-4, -5e-5)), TIME_BEFORE, ON_TIME)
        wrong = np.array([*found.force, found.torque]) - VALVES[valve]
        off.append(wrong / [found.deviation[0], found.deviation[0], found.deviation[1]])
        assert found.deviation[0] < 0.01
        assert np.abs(wrong[:2]).max() < 0.01
        assert abs(wrong[2]) < 0.004
        assert verdict(found, VALVES, valve) == ""
    # What is unknown beside noise, as the valve's delay and the turn meanwhile, counts little.
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def test_the_heading_is_enough_but_not_a_track_that_is_too_short():
    poses, rates = fly(0)
    found = estimate(Body.of(ARM, Q), poses, [], TIME_BEFORE, ON_TIME)
    assert found.torque == pytest.approx(VALVES[0, 2], abs=0.02)
    with pytest.raises(TrackError, match="0 poses before the pulse and"):
        estimate(Body.of(ARM, Q), poses, rates, 0.0, ON_TIME)


def test_valves_are_tried_in_an_order_that_leaves_the_base_slow():
    tried = valve_order(VALVES)
    assert sorted(tried) == list(range(8))
    total = np.cumsum(VALVES[tried], axis=0)
    assert np.abs(total[1::2]).max() < 1e-12  # each second one undoes the one before


def scaled(force, torque=None, valve=0):
    x, y, about = VALVES[valve]
    return Thrust((force * x, force * y), about * (torque or force), (0.002, 0.0005))


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (scaled(1.0), ""),
        (scaled(0.9), ""),
        (scaled(0.02), "no thrust: 0.003 N, expected 0.160 N"),
        (scaled(1.0, valve=3), "pushes as valve 4 should"),
        (scaled(0.5), "thrust is 0.080 N, expected 0.160 N"),
        (scaled(1.0, 1.6), "torque is 0.0282 N m, expected 0.0176 N m"),
        (Thrust((-0.11, -0.11), 0.0176, (0.002, 0.0005)),
         r"pushes along \(-0.110, -0.110\) N, expected"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said(found, words):
    got = verdict(found, VALVES, 0)
    assert re.match(words, got) if words else not got
