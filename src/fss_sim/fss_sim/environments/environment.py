"""Environments of a floating arm in Gymnasium's interfaces: one, and a batch of many."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.distributions import Distribution, parse_distribution
from fss_arm_model.files import ContentError
from fss_arm_model.parameters import parameter_names, values, with_values
from fss_sim.environments.batch import PERIOD, Batch
from fss_sim.environments.tasks import TASKS, Task

Info = dict[str, Any]


class Episodes:
    """Episodes of one task in the rows of a batch.

    Args:
        task: name of the environment.
        count: number of rows N.
        arm: name or file of the arm's description.
        randomize: distribution of each arm parameter that differs between episodes, by the names of
            fss_arm_model.parameters, such as {"m_0": {"uniform": [8.0, 12.0]}}.

    Raises:
        ContentError: the arm has no such parameter, or a distribution is malformed.
    """

    def __init__(self, task: str, count: int, arm: str, randomize: Mapping[str, Any]) -> None:
        self.arm = described(arm)
        self.task: Task = TASKS[task](Batch(self.arm, count))
        self.distributions = arm_distributions(self.arm, randomize)
        self.elapsed = np.zeros(count, dtype=int)  # periods since the start of the episode
        self.drawn_arms = 0  # number of arms drawn, which a cycle counts
        self.max_periods = round(self.task.duration / PERIOD)
        size = len(self.task.names)
        self.observations = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.actions = spaces.Box(-1.0, 1.0, (self.task.actions,), np.float32)

    def start(
        self, rows: npt.NDArray[np.intp], rng: np.random.Generator, is_seeded: bool = False
    ) -> None:
        """Start new episodes in these rows; with a new seed, a cycle of arms starts again, too."""
        if is_seeded:
            self.drawn_arms = 0
        if self.distributions:
            self.task.batch.p[rows] = [self._draw_arm(rng) for _ in rows]
        self.task.reset(rows, rng)
        self.elapsed[rows] = 0

    def _draw_arm(self, rng: np.random.Generator) -> Floats:
        names, drawn = parameter_names(self.arm.n), np.array(values(self.arm))
        for name, distribution in self.distributions.items():
            drawn[names.index(name)] = distribution.draw(rng, self.drawn_arms)
        self.drawn_arms += 1
        return with_values(self.arm, drawn).vector()

    def step(self, actions: npt.ArrayLike) -> tuple[Floats, Any, Any]:
        """Advance by PERIOD; return reward, terminated and truncated, (N,) each.

        Actions (N, task.actions) are clipped to -1 .. 1.
        """
        score = self.task.step(np.clip(np.asarray(actions, dtype=float), -1.0, 1.0))
        self.elapsed += 1
        return score.reward, score.terminated, self.elapsed >= self.max_periods

    def observe(self) -> npt.NDArray[np.float32]:
        """Return the observations, (N, size)."""
        return self.task.observe().astype(np.float32)


def arm_distributions(arm: Arm, given: Mapping[str, Any]) -> dict[str, Distribution]:
    """Return the distributions of an arm's parameters.

    Raises:
        ContentError: the arm has no such parameter, or a distribution is malformed.
    """
    names = parameter_names(arm.n)
    for name in given:
        if name not in names:
            raise ContentError("randomize", name, f"one of {', '.join(names)}")
    return {name: parse_distribution(f"randomize: {name}", value) for name, value in given.items()}


class FloatingArmEnv(gymnasium.Env[Any, Any]):
    """One arm; arguments as in Episodes."""

    def __init__(
        self, task: str, arm: str = "paper", randomize: Mapping[str, Any] | None = None
    ) -> None:
        self.episodes = Episodes(task, 1, arm, randomize or {})
        self.observation_space = self.episodes.observations
        self.action_space = self.episodes.actions

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Info]:
        """Start a new episode."""
        super().reset(seed=seed)
        self.episodes.start(np.arange(1), self.np_random, seed is not None)
        return self.episodes.observe()[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Info]:
        """Advance by PERIOD."""
        reward, terminated, truncated = self.episodes.step(np.asarray(action)[None])
        observation = self.episodes.observe()[0]
        return observation, float(reward[0]), bool(terminated[0]), bool(truncated[0]), {}


class FloatingArmVectorEnv(VectorEnv[Any, Any, Any]):
    """Many arms, advanced together; arguments as in Episodes.

    The step after the last one of an episode starts the next one: its action is ignored, its
    reward is 0.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        arm: str = "paper",
        randomize: Mapping[str, Any] | None = None,
    ) -> None:
        self.num_envs, self.metadata = num_envs, {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.episodes = Episodes(task, num_envs, arm, randomize or {})
        self.single_observation_space = self.episodes.observations
        self.single_action_space = self.episodes.actions
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Info]:
        """Start a new episode in each environment; one seed serves all."""
        seed = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=seed)
        self.episodes.start(np.arange(self.num_envs), self.np_random, seed is not None)
        self.ended[:] = False
        return self.episodes.observe(), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Info]:
        """Advance by PERIOD."""
        rewards, terminated, truncated = self.episodes.step(actions)
        if len(rows := np.flatnonzero(self.ended)):
            self.episodes.start(rows, self.np_random)
            rewards[rows], terminated[rows], truncated[rows] = 0.0, False, False
        self.ended = terminated | truncated
        return self.episodes.observe(), rewards, terminated, truncated, {}
