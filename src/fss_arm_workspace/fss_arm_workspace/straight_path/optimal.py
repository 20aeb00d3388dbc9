"""Longest straight paths found by a search over the redundancy."""

from dataclasses import replace
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.kernels import Floats
from fss_arm_workspace.straight_path.paths import (
    AWAY_FROM_LIMITS,
    MINIMUM_NORM,
    PREFERRED,
    WEIGHTED,
    Paths,
    Rules,
    concatenate,
    straight_paths,
)

OPTIMAL = "optimal"


def optimal_paths(
    arm: Arm,
    start: npt.ArrayLike,
    direction: npt.ArrayLike,
    rules: Rules | None = None,
    limits: npt.ArrayLike | None = None,
    *,
    population: int = 64,
    generations: int = 12,
    seed: int = 0,
) -> tuple[Paths, Floats]:
    """Find the longest straight paths by a search over the redundancy.

    The preferred joint rates are constant on each segment of the path; the cross-entropy method
    chooses them. With unlimited self-motion the longest path is not defined. The path returned is
    feasible, and at least as long as those of the other rules that need no preference.

    Args:
        arm: the arm.
        start: start state, (3 + n,).
        direction: (k,) in the world [rad].
        rules: settings of the paths; their redundancy is ignored.
        limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
        population: number of preferences tried in a generation.
        generations: number of generations.
        seed: seed of the random choices.

    Returns:
        The paths, and their preferred rates, (k, c, n) [rad/m]; NaN where the path of another rule
        is longer.

    Raises:
        ValueError: as straight_paths.
    """
    rules = replace(rules or Rules(), redundancy=PREFERRED)
    direction = np.atleast_1d(np.asarray(direction, dtype=float))
    rng, k = np.random.default_rng(seed), len(direction)
    segments = int(np.ceil(1.5 / rules.segment))
    mean, spread = np.zeros((k, segments, arm.n)), np.full((k, segments, arm.n), 5.0)
    best, chosen = np.full(k, -inf), mean.copy()
    directions = np.repeat(direction, population)
    for _ in range(generations):
        z = mean[:, None] + spread[:, None] * rng.standard_normal((k, population, *mean.shape[1:]))
        z[:, 0] = chosen
        preferences = z.reshape(-1, segments, arm.n)
        trial = straight_paths(arm, start, directions, rules, limits, preferences)
        length = trial.distance.reshape(k, population)
        order = np.argsort(-length, axis=1)[:, : population // 5]
        elite = np.take_along_axis(z, order[..., None, None], axis=1)
        mean, spread = elite.mean(axis=1), elite.std(axis=1) + 0.1
        longest = length.max(axis=1)
        chosen = np.where((longest > best)[:, None, None], elite[:, 0], chosen)
        best = np.maximum(best, longest)
    paths = straight_paths(arm, start, direction, rules, limits, chosen)
    paths = replace(paths, redundancy=OPTIMAL)
    for other in (MINIMUM_NORM, AWAY_FROM_LIMITS, WEIGHTED):
        alternative = straight_paths(
            arm, start, direction, replace(rules, redundancy=other), limits
        )
        is_longer = alternative.distance > paths.distance
        chosen[is_longer] = np.nan
        order = np.where(is_longer, np.arange(k) + k, np.arange(k))
        paths = concatenate(paths, alternative)[order]
    return paths, chosen
