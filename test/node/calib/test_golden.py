"""The numbers that calibrations gave before: nobody moves them unnoticed."""

import json
from math import radians
from pathlib import Path

import calib_drift
import calib_float
import calib_rig
import numpy as np
import pytest

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.kinematic.problem import HEADING_DEVIATION, POSITION_DEVIATION

DATA = Path(__file__).parents[2] / "data"
GOLDEN = json.loads((DATA / "golden.json").read_text())

STATE = np.array([0.1, 0.2, 0.3, 0.01, -0.02, 0.005, 0.0, 0.0])
RIG, FLOAT = calib_rig.Rig, calib_float.Float

#: Of each bag, which is made once, its samples.
SAMPLES = {
    "rig": lambda: RIG(DEFAULT_POSTURES, noise=0.005, seed=3).samples(),
    "lag": lambda: RIG(DEFAULT_POSTURES, noise=0.005, seed=4).samples(30_000_000),
    "long": lambda: RIG(DEFAULT_POSTURES[:6], rest=45.0, noise=0.003, seed=7, rate=50.0).samples(),
    "float": lambda: FLOAT(
        calib_float.postures(10, 5), state=STATE, noise=(0.001, 0.005), seed=6
    ).samples(tip=True),
}

#: The deviations that were the defaults then.
PAPER = {"position_deviation": POSITION_DEVIATION, "heading_deviation": HEADING_DEVIATION}
GOOD = {"position_deviation": 0.001, "heading_deviation": radians(0.5)}
WITHOUT_INERTIAS = {"priors": "m_i m_0 I_0 com_0 a_i theta_0_i mount", "max_relative": 1.0}

CASES = {
    **{
        f"rig {p} {loss}": ("rig", "kinematic", {"parametrization": p, "loss": loss, **PAPER})
        for p in ("equal", "full")
        for loss in ("square", "huber", "cauchy")
    },
    "lag equal square": ("lag", "kinematic", PAPER),
    "first": ("first", "kinematic", PAPER),
    "float square": ("float", "dynamic", GOOD | WITHOUT_INERTIAS),
    "float huber": ("float", "dynamic", {"loss": "huber", **GOOD, **WITHOUT_INERTIAS}),
    "float kinematic": ("float", "kinematic", PAPER),
    "long drift": ("long", "drift", {}),
    "float drift": ("float", "drift", {}),
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    made = {"first": DATA / "first"}

    def get(name):
        if name not in made:
            made[name] = calib_rig.record(tmp_path_factory.mktemp(name), SAMPLES[name]())
        return made[name]

    return get


#: In standard deviations. Linear algebra rounds differently on another processor or with another
#: number of threads, and the solver stops at an update below 1e-9. A drift's derivatives are
#: differences over 1e-5, and the condition of its regressor may be 1e6.
ROUNDING = {"kinematic": 1e-9, "dynamic": 1e-9, "drift": 1e-16 / 1e-5 * 1e6}


def check(name, kind, outcome):
    """Nothing has moved but by rounding."""
    most = ROUNDING[kind]
    then, p = GOLDEN[name], len(outcome.names)
    assert (outcome.verdict, list(outcome.names)) == (then["verdict"], then["names"])
    if np.isnan(then["values"]).all():
        assert np.isnan(outcome.values).all()
        assert np.isnan(outcome.covariance).all()
        return
    covariance = np.reshape(then["covariance"], (p, p))
    deviations = np.sqrt(np.diag(covariance))
    assert (np.abs(outcome.values - then["values"]) <= 1e-12 + most * deviations).all()
    known = deviations < 1e-12  # beforehand: what is left of their covariance is rounding
    deviations[known] = np.inf
    rounding = most * np.outer(deviations, deviations)
    lost = np.isin(outcome.names, [*outcome.estimate.undetermined, *outcome.estimate.at_bound])
    found = np.where(lost | lost[:, None], covariance, outcome.covariance)
    assert (np.abs(found - covariance) <= rounding).all()
    assert outcome.estimate.chi_square == pytest.approx(then["chi_square"], rel=most)


@pytest.mark.parametrize("name", CASES)
def test_the_numbers_are_those_found_then(name, bag):
    source, kind, settings = CASES[name]
    record = KINDS[kind]
    check(name, kind, solve_bag(record, bag(source), record.settings(**settings)))


def test_the_drifts_of_a_simulated_base():
    found, _ = calib_drift.drifts(11)
    outcome = KINDS["drift"].calibrate(found, calib_drift.ARM)
    check("drifts", "drift", outcome)


def test_no_case_is_forgotten():
    assert GOLDEN.keys() == {*CASES, "drifts"}
