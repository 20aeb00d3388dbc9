"""The plant behind the contract of a law, and as an FMU, beside the plant itself."""

from pathlib import Path

import fmpy
import fmu
import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import load
from fss_gnc.law import Outputs
from fss_rehearsal.law_plant import LawPlant
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand

ARM = Path(__file__).parents[3] / "config/truth.yaml"
START = np.array([0.1, -0.05, 0.2, 0.6, -0.6, -0.6, 0.6])
PERIOD, DURATION = 0.02, 10.0


def commands(time):
    """Return on-times of the valves and rates of the joints."""
    rates = 0.2 * np.sin(0.7 * time + np.arange(4.0))
    return np.where((np.arange(8) + round(time)) % 3 == 0, 0.015, 0.0), rates


def plain_flight(arm):
    """Return times, and the states (7,), (7,) before each step, of the plant itself."""
    plant, states = Plant(arm, START), []
    for time in np.arange(0.0, DURATION, PERIOD):
        states.append(np.concatenate([plant.q, plant.qd]))
        on_times, rates = commands(time)
        plant.thrust(on_times)
        for i, rate in enumerate(rates.tolist()):
            plant.command(i, Demand(MODE_VELOCITY, rate, abs(rate)))
        plant.advance(PERIOD)
    return np.array(states)


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_fmu_of_the_plant_is_the_plant(fmi, tmp_path):
    expected = plain_flight(load(ARM))
    assert np.abs(expected[-1, :7] - START).min() > 1e-3
    path, folder = tmp_path / "plant.fmu", str(tmp_path / "unzipped")
    fmu.export(fmu.plant_model(ARM, load(ARM)), fmi, path)
    description = fmpy.read_model_description(str(path))
    named = {v.name: v.valueReference for v in description.modelVariables}
    kinds = ("Real", "Integer") if fmi == 2 else ("Float64", "Int32")

    def access(what, kind, name, size, *values):
        names = [f"{name}[{i + 1}]" for i in range(size)] if fmi == 2 and size else [name]
        call = getattr(instance, what + kinds[kind])
        sizes = [size] if fmi == 3 and what == "get" else []
        return call([named[one] for one in names], *values, *sizes)

    fmpy.extract(str(path), folder)
    instance = fmpy.instantiate_fmu(folder, description)
    if fmi == 2:
        instance.setupExperiment()
    instance.enterInitializationMode()
    access("set", 0, "start_pose", 3, START[:3].tolist())
    access("set", 0, "start_joint_angles", 4, START[3:].tolist())
    instance.exitInitializationMode()
    access("set", 1, "wrench_valid", 0, [0])
    access("set", 1, "valve_on_times_valid", 0, [1])
    for k, row in enumerate(expected):
        outputs = ("base_pose", 3), ("joint_angles", 4), ("base_twist", 3), ("joint_rates", 4)
        got = np.concatenate([access("get", 0, *one) for one in outputs])
        np.testing.assert_array_equal(got, row)
        on_times, rates = commands(k * PERIOD)
        access("set", 0, "valve_on_times", 8, on_times.tolist())
        access("set", 0, "joint_velocities", 4, rates.tolist())
        instance.doStep(k * PERIOD, PERIOD)
    instance.terminate()
    instance.freeInstance()


@pytest.mark.parametrize(
    ("outputs", "period", "words"),
    [
        (Outputs(wrench=np.full(3, np.nan)), 0.02, "wrench is"),
        (Outputs(), 0.0005, r"0.0005 s, expected a multiple of 0.001 s"),
    ],
)
def test_the_plant_refuses_what_it_cannot_do(outputs, period, words):
    with pytest.raises(ValueError, match=words):
        LawPlant(paper_arm(), START).advance(outputs, period)
