"""The example of training: gradients, files, and a policy that learns within seconds."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_sim.environments.register import register_environments

sys.path.append(str(Path(__file__).parents[3] / "docs/examples"))

import train_reach


@pytest.fixture(scope="module")
def policy():
    return train_reach.train(paper_arm(), np.random.default_rng(1), np.linspace(0.0, 1.0, 8))


def test_gradients_are_the_derivatives_of_the_error(policy):
    rng = np.random.default_rng(2)
    weights = [w.astype(float) for w in policy.weights]
    double = train_reach.Policy(weights, policy.max_rate)
    inputs, desired = rng.normal(size=(5, 12)), rng.normal(size=(5, 4))
    gradients = double.gradients(inputs, desired)
    for w, gradient in zip(weights, gradients, strict=True):
        direction = rng.normal(size=w.shape)
        costs = []
        for step in (1e-5, -1e-5):
            w += step * direction
            costs.append(0.5 * np.mean(np.sum((double.layers(inputs)[-1] - desired) ** 2, axis=1)))
            w -= step * direction
        assert np.sum(gradient * direction) == pytest.approx(np.diff(costs[::-1])[0] / 2e-5, 1e-6)


def test_a_few_rounds_make_the_end_effector_arrive(policy):
    register_environments()
    arrivals, *_ = train_reach.evaluate(policy, "paper", episodes=60)
    assert arrivals > 30.0  # percent


def test_a_saved_policy_gives_the_same_rates(policy, tmp_path):
    train_reach.save(policy, tmp_path / "reach.npz")
    rng = np.random.default_rng(3)
    q, offset = rng.uniform(-1.0, 1.0, (20, 4)), rng.uniform(-0.5, 0.5, (20, 3))
    rates = train_reach.load(tmp_path / "reach.npz")(q, offset)
    np.testing.assert_array_equal(rates, policy(q, offset))
    assert (np.abs(rates) <= policy.max_rate).all()
    assert np.abs(rates).max() > 0.1
