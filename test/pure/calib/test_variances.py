"""Variance components of rests: the restricted likelihood, its mean, and what they change."""

from dataclasses import replace

import numpy as np
import pytest
from calib_rests import ARM, observe, seen_tips
from scipy.optimize import minimize

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.problem import FULL, KinematicProblem
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_model.estimation.variances import (
    MAX_SHARE_UNCERTAINTY,
    Nodes,
    first_nodes,
    log_prior,
    mean_variances,
    restricted_log_likelihood,
)
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.layout import kinematic_index

SETTINGS = KinematicSettings(parametrization=FULL)
BASE_DOMINATES = (0.0005, np.radians(0.1), np.radians(0.4))  # position, tip's and base's heading


def test_the_likelihood_is_that_of_its_definition():
    """log |V| + log |X' V^-1 X| + r' P r of all observations together, and of repeated ones."""
    rng = np.random.default_rng(1)
    s, p = 7, 4
    r, X = rng.standard_normal((s, 3)), rng.standard_normal((s, 3, p))
    root = rng.standard_normal((5, s, 3, 3)) + 2.0 * np.eye(3)
    V = root @ np.swapaxes(root, -1, -2)
    found = restricted_log_likelihood(r, X, np.ones(s), V)
    dense = np.zeros((5, s, 3, s, 3))
    dense[:, np.arange(s), :, np.arange(s), :] = np.swapaxes(V, 0, 1)
    for value, whole in zip(found, dense.reshape(5, 3 * s, 3 * s), strict=True):
        W, x = np.linalg.inv(whole), X.reshape(3 * s, p)
        P = W - W @ x @ np.linalg.inv(x.T @ W @ x) @ x.T @ W
        terms = (
            np.linalg.slogdet(whole)[1],
            np.linalg.slogdet(x.T @ W @ x)[1],
            r.ravel() @ P @ r.ravel(),
        )
        assert value == pytest.approx(-0.5 * sum(terms), rel=1e-12)
    twice = [np.concatenate([one, one]) for one in (r, X, np.ones(s))]
    assert restricted_log_likelihood(r, X, 2.0 * np.ones(s), V[0]) == pytest.approx(
        float(restricted_log_likelihood(*twice, np.concatenate([V[0], V[0]]))), rel=1e-12
    )


def test_its_maximum_is_the_analysis_of_variance():
    """Balanced groups with a common mean: REML equals the mean squares (Searle et al., 1992)."""
    rng = np.random.default_rng(2)
    s = 40
    y = 3.0 + 2.0 * rng.standard_normal((s, 1)) + 0.5 * rng.standard_normal((s, 3))
    between = 3.0 * np.sum((y.mean(axis=1) - y.mean()) ** 2) / (s - 1)
    within = np.sum((y - y.mean(axis=1, keepdims=True)) ** 2) / (2 * s)

    def loss(log_variances):
        own, group = np.exp(log_variances)
        V = np.broadcast_to(own * np.eye(3) + group, (s, 3, 3))
        return -float(restricted_log_likelihood(y, np.ones((s, 3, 1)), np.ones(s), V))

    found = np.exp(minimize(loss, np.zeros(2), method="Nelder-Mead", tol=1e-10).x)
    assert found == pytest.approx([within, (between - within) / 3.0], rel=1e-4)


@pytest.mark.parametrize("apart", [0.01, 1.0, 100.0])
def test_the_mean_is_that_of_known_distributions(apart):
    """Of two chi-squares S / (nu - 2), of a share that of a beta distribution; from any start."""
    S, nu, (a, b) = np.array([3e-5, 8e-4]), np.array([18.0, 11.0]), (9.0, 3.0)

    def log_likelihood(v):
        share = v[:, 2] / v[:, 1]
        log = -0.5 * (nu * np.log(v[:, :2]) + S / v[:, :2]).sum(axis=1)
        return log + a * np.log(share) + b * np.log(1.0 - share)  # of the logit

    found, nodes = mean_variances(log_likelihood, first_nodes(apart * np.sqrt(S / nu)))
    share = a / (a + b)
    assert found.mean[:2] == pytest.approx(S / (nu - 2.0), rel=0.01)
    assert found.mean[2] == pytest.approx(share * found.mean[1], rel=0.01)
    assert found.share_uncertainty == pytest.approx(
        np.sqrt(share * (1.0 - share) / (a + b + 1.0)), rel=0.05
    )
    again, _ = mean_variances(log_likelihood, nodes)
    assert again.mean == pytest.approx(found.mean, rel=2e-3)


def test_without_data_the_share_stays_what_it_was_assumed():

    def headings_are_known(v):
        return log_prior(v, 4.0) - 50.0 * np.log(v[:, 1]) ** 2

    found, _ = mean_variances(headings_are_known, Nodes(np.zeros(3), np.eye(3)))
    assert found.mean[2] / found.mean[1] == pytest.approx(0.5)
    assert found.share_uncertainty > MAX_SHARE_UNCERTAINTY


def test_poses_have_the_covariance_of_what_their_subjects_err():
    """Against errors of the base's pose and the end effector's, propagated through the pose."""
    rng, count = np.random.default_rng(3), 200_000
    q = DEFAULT_POSTURES[:3]
    position, tip, base = 0.003, 0.004, 0.005
    problem = KinematicProblem(
        q,
        tip_in_base(ARM.vector(), q),
        ARM,
        position_deviation=position,
        heading_deviation=np.hypot(tip, base),
        base_heading_deviation=base,
    )
    seen = seen_tips(problem.tip, (position, tip, base), rng, count)
    for k, errors in enumerate(np.moveaxis(seen - problem.tip, 1, 0)):
        V = problem.covariance(problem.variances)[k]
        scale = np.sqrt(np.outer(np.diag(V), np.diag(V)))
        assert np.abs(np.cov(errors.T) - V).max() < 0.02 * scale.max()
        whitened = errors @ problem.whitening[k].T
        assert np.cov(whitened.T) == pytest.approx(np.eye(3), abs=0.02)


def calibrated(deviations, seed):
    rng, q = np.random.default_rng(seed), DEFAULT_POSTURES
    seen = observe(q, sigma=np.zeros(3))
    (tips,) = seen_tips(tip_in_base(ARM.vector(), q), deviations, rng)
    return calibrate(
        [replace(o, tip=tuple(t)) for o, t in zip(seen, tips.tolist(), strict=True)], ARM, SETTINGS
    )


def test_errors_are_as_large_as_claimed_if_the_bases_heading_dominates():
    """With one deviation of positions, lengths would err by 1.3 deviations, offsets by 0.7."""
    truth, z = ARM.vector()[kinematic_index(4)], []
    for seed in range(40):
        found = calibrated(BASE_DOMINATES, seed)
        z.append((found.values - truth) / found.deviations)
        noise = found.solution.noise
    z = np.square(z)
    assert np.sqrt(np.mean(z[:, :4])) == pytest.approx(1.0, abs=0.15)
    assert np.sqrt(np.mean(z[:, 4:7])) == pytest.approx(1.0, abs=0.15)
    assert noise.is_separated
    assert abs(noise.base_heading - BASE_DOMINATES[2]) < 3.0 * noise.base_uncertainty
    assert "of it the base 0." in str(noise)
    assert "not separated" not in str(noise)


def test_what_is_found_can_be_given():
    """A joint estimate weighs the rests as their own calibration does."""
    found = calibrated(BASE_DOMINATES, 5)
    s = found.solution.noise.apply_to(SETTINGS)
    given = calibrate(found.data, ARM, s)
    assert given.solution.noise.is_given.all()
    np.testing.assert_allclose(given.values, found.values, rtol=1e-9)
    np.testing.assert_allclose(given.covariance, found.covariance, rtol=1e-9)


def test_headings_that_do_not_move_positions_are_not_separated():
    found = calibrated((0.02, np.radians(0.05), np.radians(0.05)), 1)
    assert not found.solution.noise.is_separated
    assert "(not separated)" in str(found.solution.noise)
