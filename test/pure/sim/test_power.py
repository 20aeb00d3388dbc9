"""Battery, converter and what lives on them: figures as stated, and how they give up."""

from itertools import pairwise

import pytest

from fss_sim.link.power import BROWN_OUT, CELLS, EFFICIENCY, LOWEST, Battery, Load, Power, Supply

OFF, HARD = Load(on=False), Load(on=True, current=2.25, mechanical=1.8)


def run(supply, load, seconds, more=0.0):
    for _ in range(round(100 * seconds)):
        supply.advance(load, 0.01, more)
    return supply


def test_a_battery_gives_the_energy_that_it_has_less_what_its_resistance_takes():
    battery, given, volts = Battery(89.0, 0.1), 0.0, []
    while battery.charge:
        volts.append(battery.volts)
        given += 10.0 / 3600.0 * battery.draw(0.0, 10.0, 10.0)
    assert volts[0] == pytest.approx(CELLS * 4.2)
    assert all(b < a for a, b in pairwise(volts))
    assert volts[-1] == pytest.approx(CELLS * 3.0, abs=0.2)
    assert 14.2 < volts[len(volts) // 2] < 15.0  # 14.4 V nominally
    assert given == pytest.approx(89.0 * (1.0 - 0.1 * (10.0 / 14.8) / 14.8), rel=5e-3)


def test_its_voltage_solves_the_circuit_and_never_falls_below_what_the_converter_needs():
    battery = Battery(charge=0.5)
    for current, power in ((0.0, 0.0), (1.0, 0.0), (0.25, 15.0), (0.25, 60.0)):
        assert battery.draw(current, power, 0.0, 0.4) == power
        assert battery.volts == pytest.approx(
            battery.open - 0.5 * (current + power / battery.volts), rel=1e-12
        )
    given = battery.draw(0.25, 60.0, 0.0, 3.9)
    assert battery.volts == pytest.approx(LOWEST)
    assert given == pytest.approx(LOWEST * (battery.open - 1.0 - LOWEST) / 4.0)


def test_it_warms_itself_and_resists_less():
    battery = Battery()
    for _ in range(600):
        battery.draw(4.0, 0.0, 1.0)
    assert battery.temperature > 28.0
    assert battery.open - battery.volts < 4.0 * 0.1


def test_consumption_is_by_what_runs():
    power, drawn = Power(), []
    for load in (OFF, Load(on=True), Load(on=True, current=1.5), HARD):
        supply = Supply(power)
        before = supply.battery.charge
        run(supply, load, 1.0)
        drawn.append((before - supply.battery.charge) * supply.battery.capacity * 16.7)
    logic = 16.7 * (power.electronics + power.wifi)
    for motor, watts in zip((0.0, power.switching, 6.0, 1.5 + 10.125 + 1.8), drawn, strict=True):
        assert watts == pytest.approx(logic + (power.idle + motor) / EFFICIENCY, rel=0.02)


def test_a_bad_contact_makes_the_supply_sag_under_load_alone():
    supply = run(Supply(), OFF, 0.1, more=5.0)
    assert supply.volts == pytest.approx(24.0)
    assert 5.0 < run(supply, HARD, 0.1, more=5.0).volts < 20.0
    assert supply.runs
    assert run(supply, OFF, 0.1, more=5.0).volts == pytest.approx(24.0)


def test_the_converters_limit_is_one_of_power():
    supply = run(Supply(), Load(on=True, current=6.0), 0.1)
    asked = (2.5 + 1.5 + 72.0) / EFFICIENCY
    assert supply.volts == pytest.approx(24.0 * 60.0 / asked)


def test_a_brown_out_ends_only_well_above_where_it_began():
    supply, seen = Supply(charge=0.5), []
    for more in [*range(20, 45), *range(45, 20, -1)]:
        run(supply, OFF, 0.02, more)
        seen.append((supply.runs, supply.battery.volts))
    states = [runs for runs, _ in seen]
    assert [a for a, b in pairwise(states) if a != b] == [True, False]
    down = seen[states.index(False)][1]
    up = seen[len(states) - 1 - states[::-1].index(False)][1]
    assert down < BROWN_OUT < up < 7.6


def test_an_empty_battery_switches_all_off_until_it_is_charged():
    supply = run(Supply(charge=1e-6), OFF, 1.0)
    assert (supply.runs, supply.volts) == (False, 0.0)
    supply.battery.charge = 1.0
    run(supply, OFF, 0.02)
    assert supply.runs
    assert supply.volts == pytest.approx(24.0)


def test_what_is_switched_off_draws_nothing():
    supply = run(Supply(charge=0.5), None, 10.0)
    assert (supply.battery.charge, supply.volts) == (0.5, 0.0)
