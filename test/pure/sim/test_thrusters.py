"""Thrusters: forces and torques of the square, valves in time, propellant and pressure."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.thrusters import CORNERS, thruster_wrenches
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.thrusters import Propulsion, Thrusters
from fss_sim.plant.vehicle import World

FLOW = 0.16 / (34.0 * 9.81)  # [kg/s]


def pulse(*numbers, seconds=1.0):
    return [seconds if i in numbers else 0.0 for i in range(8)]


def test_pairs_give_each_force_and_torque_alone():
    L = thruster_wrenches(0.16, 0.11)
    np.testing.assert_allclose(L.sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.abs(L[:, 2]), 0.16 * 0.11)
    at = 0.11 * np.repeat(CORNERS, 2, axis=0)
    np.testing.assert_allclose(L[:, 2], at[:, 0] * L[:, 1] - at[:, 1] * L[:, 0])
    for effect in ([0.32, 0, 0], [-0.32, 0, 0], [0, 0.32, 0], [0, -0.32, 0]):
        pair = [i for i in range(8) if L[i, :2] @ effect[:2] > 0.0]
        assert len(pair) == 2
        np.testing.assert_allclose(L[pair].sum(axis=0), effect, atol=1e-15)
    for sign in (1, -1):
        turning = L[sign * L[:, 2] > 0.0]
        np.testing.assert_allclose(turning.sum(axis=0), [0, 0, sign * 4 * 0.0176], atol=1e-15)


@pytest.mark.parametrize("on_time", [0.010, 0.4])
def test_a_pulse_gives_its_impulse_and_takes_its_propellant(on_time):
    bed = Plant(paper_arm(), np.zeros(7))
    numbers = [i for i in range(8) if bed.thrusters.layout[i, 0] > 0.0]
    bed.thrust(pulse(*numbers, seconds=on_time))
    for _ in range(100):
        bed.advance(0.01)
    assert bed.audit.impulse[0] == pytest.approx(2 * 0.16 * on_time, rel=1e-3)
    assert bed.thrusters.propellant_used == pytest.approx(2 * FLOW * on_time, rel=1e-12)
    np.testing.assert_allclose(bed.audit.balance, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("commands", "is_open"),
    [
        ({100: 1.0}, range(105, 1105)),
        ({100: 1.0, 600: 0.0}, range(105, 605)),
        ({700: 1.0, 703: 0.0, 707: 0.0}, range(705, 715)),  # never shorter than the minimum
        ({0: 0.05, 40: 0.05}, range(5, 95)),
        ({0: 0.009}, range(0)),  # below the minimum
        ({0: 0.1, 100: 0.0}, range(5, 105)),
        ({0: 0.2, 200: 0.2, 400: 0.2, 600: 0.2}, range(5, 805)),
    ],
)
@pytest.mark.parametrize("delay", [0, 50])
def test_a_valve_is_open_as_commanded_after_its_delay(commands, is_open, delay):
    """Commands are on times [s] by the time [ms] at which they come."""
    valves, found = Thrusters(Propulsion(valve_delay=0.001 * delay)), []
    for now in range(1500):
        if now in commands:
            valves.command(pulse(3, seconds=commands[now]), now)
        found += [now + 5 - delay] if valves.open_valves(now)[3] else []
    assert found == list(is_open)


def test_an_empty_tank_gives_no_thrust():
    small = Propulsion(tank_volume=0.43e-5)  # 1 g
    bed = Plant(paper_arm(), np.zeros(7), None, World(propulsion=small))
    mass = bed._p[0]
    bed.thrust(pulse(0, 1, seconds=1000.0))
    pressures, gains, before = [], [], 0.0
    for _ in range(400):
        bed.advance(0.01)
        pressures.append(bed.thrusters.pressure)
        gains.append(np.hypot(*bed.audit.impulse[:2]) - before)
        before += gains[-1]
    assert (np.diff(pressures) <= 0.0).all()
    assert pressures[-1] < 0.01 * small.regulator_pressure
    assert gains[-1] < 0.01 * max(gains)
    assert mass - bed._p[0] == pytest.approx(bed.thrusters.propellant_used)
    assert bed.thrusters.propellant_used == pytest.approx(bed.thrusters.capacity, rel=1e-2)


def test_the_audit_balances_while_mass_is_lost():
    rng = np.random.default_rng(0)
    q, qd = rng.uniform(-0.5, 0.5, (2, 7))
    world = World(surroundings=Surroundings(table=(20.0, 20.0)))
    bed = Plant(paper_arm(), q, 0.3 * qd, world)
    start, first = bed.audit.balance, bed.audit.momentum.copy()
    for _ in range(20):
        bed.thrust(rng.uniform(0.0, 0.2, 8))
        bed.advance(0.1)
    assert np.abs(bed.audit.momentum - first).min() > 1e-3
    assert bed.thrusters.propellant_used > 1e-3
    np.testing.assert_allclose(bed.audit.balance, start, rtol=0, atol=1e-9)


@pytest.mark.parametrize("times", [[0.0] * 7, [0.0] * 7 + [-1.0], [0.0] * 7 + [float("nan")]])
def test_invalid_commands_are_rejected(times):
    with pytest.raises(ValueError, match="expected 8 of 0 or more"):
        Thrusters().command(times, 0)


AIR = Propulsion(bearing_flow=6e-5)


def test_bearings_empty_the_tank_in_the_time_that_their_flow_says():
    tank, steps = Thrusters(AIR), 0
    while tank.floats:
        tank.use_bearing_air(1000)
        steps += 1
    used_until = tank.capacity * (1.0 - AIR.regulator_pressure / AIR.tank_pressure)
    assert used_until / AIR.bearing_flow < steps < tank.capacity / AIR.bearing_flow
    assert 27 * 60 < steps < 29 * 60
    assert tank.pressure == pytest.approx(AIR.bearing_pressure, rel=0.01)


def test_bearings_fed_from_outside_never_fail():
    tank = Thrusters(used=1.0)
    assert (tank.pressure, tank.thrust) == (0.0, 0.0)
    assert tank.floats
    assert tank.use_bearing_air(1000) == 0.0


BENT = (0.0, 0.0, 0.0, 0.4, -0.3, 0.2, 0.5)


def vehicle_with_empty_tank(twist=(0.2, -0.1, 0.3), q=BENT, tolerance=0.0):
    """A vehicle that moves as its tank has just become empty."""
    arm, around = paper_arm(), Surroundings(table=(20.0, 20.0), pad_friction=0.2)
    world = World(propulsion=AIR, surroundings=around, tolerance=tolerance)
    qd = np.array([*twist, 0.0, 0.0, 0.0, 0.0])
    bed = Plant(arm, q, qd, world, propellant=1.0)
    assert not bed.thrusters.floats
    return bed


@pytest.mark.parametrize(("tolerance", "exact"), [(0.0, 1e-6), (1e-10, 1e-9)])
def test_without_air_the_vehicle_stops_by_coulombs_law(tolerance, exact):
    bed = vehicle_with_empty_tank(twist=(0.2, 0.0, 0.0), tolerance=tolerance)
    mass, g = bed._p[0] + sum(link.mass for link in bed.arm.links), 9.80665
    energy = [bed.audit.energy]
    for _ in range(20):
        bed.advance(0.01)
        energy.append(bed.audit.energy)
    assert bed.qd[0] < 0.001  # after 0.2 / (0.2 g) = 0.102 s
    way = bed.q[0]
    assert way == pytest.approx(0.2**2 / (2.0 * 0.2 * g), rel=0.03)
    assert energy[5] == pytest.approx(0.5 * mass * (0.2 - 0.05 * 0.2 * g) ** 2, rel=0.01)
    assert (np.diff(energy) <= 0.0).all()
    assert np.abs(bed.imbalance[:3]).max() < 1e-12
    assert abs(bed.imbalance[3]) < exact


def test_the_audit_balances_without_air_and_nothing_creeps():
    bed = vehicle_with_empty_tank(tolerance=1e-10)
    bed.advance(1.0)
    assert np.abs(bed.imbalance).max() < 1e-9
    assert np.abs(bed.qd).max() < 1e-4
    before = bed.q[:2].copy()
    bed.thrusters.propellant_used = 0.1 * bed.thrusters.capacity
    bed.thrust(pulse(0, 6, seconds=10.0))
    bed.thrusters.propellant_used = bed.thrusters.capacity * (
        1.0 - 0.9 * AIR.bearing_pressure / AIR.tank_pressure
    )
    bed.advance(5.0)
    assert np.abs(bed.q[:2] - before).max() < 1e-3  # 0.2 N against 40 N
