"""Battery, converter and their loads: stated values, limits and brown-out."""

from itertools import pairwise

import pytest

from fss_sim.link.power import (
    BROWN_OUT_VOLTAGE,
    CELLS,
    EFFICIENCY,
    MIN_INPUT_VOLTAGE,
    Battery,
    Load,
    Power,
    Supply,
)

DRIVE_OFF, DRIVE_AT_FULL_LOAD = Load(on=False), Load(on=True, current=2.25, mechanical=1.8)


def run(supply, load, seconds, extra_resistance=0.0):
    for _ in range(round(100 * seconds)):
        supply.advance(load, 0.01, extra_resistance)
    return supply


def test_a_battery_supplies_its_energy_less_the_loss_in_its_resistance():
    battery, given, volts = Battery(89.0, 0.1), 0.0, []
    while battery.charge:
        volts.append(battery.volts)
        given += 10.0 / 3600.0 * battery.draw(0.0, 10.0, 10.0)
    assert volts[0] == pytest.approx(CELLS * 4.2)
    assert all(b < a for a, b in pairwise(volts))
    assert volts[-1] == pytest.approx(CELLS * 3.0, abs=0.2)
    assert 14.2 < volts[len(volts) // 2] < 15.0  # 14.4 V nominally
    assert given == pytest.approx(89.0 * (1.0 - 0.1 * (10.0 / 14.8) / 14.8), rel=5e-3)


def test_its_voltage_solves_the_circuit_and_stays_above_the_converters_minimum():
    battery = Battery(charge=0.5)
    for current, power in ((0.0, 0.0), (1.0, 0.0), (0.25, 15.0), (0.25, 60.0)):
        assert battery.draw(current, power, 0.0, 0.4) == power
        assert battery.volts == pytest.approx(
            battery.open_circuit_voltage - 0.5 * (current + power / battery.volts), rel=1e-12
        )
    warm = Battery()
    for _ in range(600):
        warm.draw(4.0, 0.0, 1.0)
    assert warm.temperature > 28.0
    assert warm.open_circuit_voltage - warm.volts < 4.0 * 0.1  # its resistance decreases
    given = battery.draw(0.25, 60.0, 0.0, 3.9)
    assert battery.volts == pytest.approx(MIN_INPUT_VOLTAGE)
    assert given == pytest.approx(
        MIN_INPUT_VOLTAGE * (battery.open_circuit_voltage - 1.0 - MIN_INPUT_VOLTAGE) / 4.0
    )


def test_consumption_depends_on_the_active_loads():
    power, drawn = Power(), []
    for load in (DRIVE_OFF, Load(on=True), Load(on=True, current=1.5), DRIVE_AT_FULL_LOAD):
        supply = Supply(power)
        before = supply.battery.charge
        run(supply, load, 1.0)
        drawn.append((before - supply.battery.charge) * supply.battery.capacity * 16.7)
    logic = 16.7 * (power.electronics + power.wifi)
    for motor, watts in zip((0.0, power.switching, 6.0, 1.5 + 10.125 + 1.8), drawn, strict=True):
        assert watts == pytest.approx(logic + (power.idle + motor) / EFFICIENCY, rel=0.02)


def test_a_bad_contact_lowers_the_supply_only_under_load():
    supply = run(Supply(), DRIVE_OFF, 0.1, extra_resistance=5.0)
    assert supply.volts == pytest.approx(24.0)
    assert 5.0 < run(supply, DRIVE_AT_FULL_LOAD, 0.1, extra_resistance=5.0).volts < 20.0
    assert supply.regulator_on
    assert run(supply, DRIVE_OFF, 0.1, extra_resistance=5.0).volts == pytest.approx(24.0)


def test_the_converter_limits_its_power():
    supply = run(Supply(), Load(on=True, current=6.0), 0.1)
    requested = (2.5 + 1.5 + 72.0) / EFFICIENCY
    assert supply.volts == pytest.approx(24.0 * 60.0 / requested)


def test_brown_out_has_hysteresis():
    supply, history = Supply(charge=0.5), []
    for extra_resistance in [*range(20, 45), *range(45, 20, -1)]:
        run(supply, DRIVE_OFF, 0.02, extra_resistance)
        history.append((supply.regulator_on, supply.battery.volts))
    states = [runs for runs, _ in history]
    assert [a for a, b in pairwise(states) if a != b] == [True, False]
    down = history[states.index(False)][1]
    up = history[len(states) - 1 - states[::-1].index(False)][1]
    assert down < BROWN_OUT_VOLTAGE < up < 7.6


def test_an_empty_battery_switches_everything_off_until_it_is_charged():
    supply = run(Supply(charge=1e-6), DRIVE_OFF, 1.0)
    assert (supply.regulator_on, supply.volts) == (False, 0.0)
    supply.battery.charge = 1.0
    run(supply, DRIVE_OFF, 0.02)
    assert supply.regulator_on
    assert supply.volts == pytest.approx(24.0)
