"""The designed experiment in a laboratory that knows little: errors are as large as claimed."""

from dataclasses import replace

import numpy as np
import pytest
from calib_float import COUNT

from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solve import solve
from fss_arm_calib.experiment.design import design, predicted_problem, windowed_paths
from fss_arm_calib.experiment.settings import Conditions
from fss_arm_model.base_motion import base_poses
from fss_arm_model.description import paper_arm
from fss_arm_model.joint_path import path, sampled, stack
from fss_arm_model.parameters import to_vector, values

ARM, REST = paper_arm(), 5.2
SETTINGS = DynamicSettings()
PERIOD = 0.2  # of telemetry [s]


def plan(count, tried):
    """As the rehearsal `dynamic` has it."""
    return design(
        ARM, count, SETTINGS, Conditions(rest=REST, table=(3.7, 3.7)), seed=1, tried=tried,
        chosen=[f"b_{i}" for i in range(1, 5)], begin=np.array([0.6, -1.0, 1.0, -0.6]),
    )  # fmt: skip


def as_read(one, rng):
    """A maneuver's path by its telemetry: each link in its own phase, to a count."""
    law, times, q, qd = one.law()[0], [], [], []
    for joint in range(ARM.n):
        t = np.arange(-PERIOD * rng.random(), one.length + PERIOD, PERIOD)
        angles, rates = (part[:, joint] for part in law(t))
        times.append(t)
        q.append(np.round(angles / COUNT) * COUNT)
        qd.append(rates)
    return path(*sampled(times, q, qd), looks(one))


def looks(one):
    """Times of the marks [s]."""
    t = windowed_paths([one], SETTINGS, REST)[0].marks[0, :, -1]
    return t - 0.5 * (t[0] + t[-1] - one.length - SETTINGS.settle_time)


def draw_truth(rng):
    """Errors of all parameters: of b and I freely, of the others by what is known of them."""
    n = ARM.n
    errors = SETTINGS.deviations(n) * rng.standard_normal(5 * n + 6)
    errors[3 * n + 6 : 4 * n + 6] = rng.uniform(-0.015, 0.015, n)
    errors[4 * n + 6 :] = rng.uniform(-0.25, 0.25, n) * values(ARM)[4 * n + 6 :]
    return errors


def trial(known, maneuvers, rng):
    """Normalized squared error a parameter, and chi-square a degree of freedom."""
    errors, states = draw_truth(rng), np.zeros((len(maneuvers), 8))
    states[:, :3] = rng.uniform(-1.0, 1.0, (len(states), 3)) * [0.5, 0.5, 3.0]
    states[:, 3:6] = known.momentum * rng.standard_normal((len(states), 3))
    states[:, 6:] = known.tilt * rng.standard_normal(2)
    poses = base_poses(ARM.vector() + to_vector(ARM.n) @ errors, known.path, states)
    poses += known.sigma * rng.standard_normal(poses.shape)
    read = stack([as_read(one, rng) for one in maneuvers])
    result = solve(replace(known, path=read, poses=poses), bounded=False)
    assert result.minimum.converged
    error = result.values - known.guess - [*(known.choice.basis.T @ errors), *states[0, 6:]]
    nees = error @ np.linalg.solve(result.covariance, error) / len(error)
    return nees, result.chi_square / known.degrees_of_freedom


def trials(maneuvers, count, seed):
    known, rng = predicted_problem(ARM, maneuvers, SETTINGS, REST), np.random.default_rng(seed)
    return np.mean([trial(known, maneuvers, rng) for _ in range(count)], axis=0)


def test_looks_are_before_and_after():
    (one,) = plan(1, 10)
    t = looks(one)
    assert t[3] < 0.0 < one.length + SETTINGS.settle_time < t[4]
    assert -t[0] == pytest.approx(t[-1] - one.length - SETTINGS.settle_time)


@pytest.mark.slow
def test_errors_are_as_large_as_claimed_over_500_trials():
    """Base, kinematics, masses, momenta and tilt uncertain, no bound in force: a minute."""
    nees, chi_square = trials(plan(16, 500), 500, seed=5)
    print(f"NEES {nees:.3f} a parameter, chi-square {chi_square:.3f} a degree of freedom")
    assert nees == pytest.approx(1.0, abs=0.1)
    assert chi_square == pytest.approx(1.0, abs=0.02)
