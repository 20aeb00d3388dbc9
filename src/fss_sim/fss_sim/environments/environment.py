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
        self.episodes = 0  # number of started episodes
        self.max_periods = round(self.task.duration / PERIOD)
        size = len(self.task.names)
        self.observations = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.actions = spaces.Box(-1.0, 1.0, (self.task.actions,), np.float32)

    def start(self, rows: npt.NDArray[np.intp], rng: np.random.Generator) -> None:
        """Start new episodes in these rows."""
        if self.distributions:
            self.task.batch.p[rows] = [self._draw_arm(rng) for _ in rows]
        self.task.reset(rows, rng)
        self.elapsed[rows] = 0

    def _draw_arm(self, rng: np.random.Generator) -> Floats:
        names, drawn = parameter_names(self.arm.n), np.array(values(self.arm))
        for name, distribution in self.distributions.items():
            drawn[names.index(name)] = distribution.draw(rng, self.episodes)
        self.episodes += 1
        return with_values(self.arm, drawn).vector()

    def step(self, actions: npt.ArrayLike) -> tuple[Floats, Any, Any]:
        """Advance by a period; return rewards, and whether episodes end or are cut off, (N,)."""
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


class FloatingArm(gymnasium.Env[Any, Any]):
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
        self.episodes.start(np.arange(1), self.np_random)
        return self.episodes.observe()[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, Info]:
        """Advance by one period of 0.05 s."""
        reward, terminated, truncated = self.episodes.step(np.asarray(action)[None])
        observation = self.episodes.observe()[0]
        return observation, float(reward[0]), bool(terminated[0]), bool(truncated[0]), {}


class FloatingArms(VectorEnv[Any, Any, Any]):
    """Many arms, advanced together; arguments as in Episodes.

    The step after the last one of an episode starts the next one, without an action.
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
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        self.episodes.start(np.arange(self.num_envs), self.np_random)
        self.ended[:] = False
        return self.episodes.observe(), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Info]:
        """Advance by one period of 0.05 s."""
        rewards, terminated, truncated = self.episodes.step(actions)
        if len(rows := np.flatnonzero(self.ended)):
            self.episodes.start(rows, self.np_random)
            rewards[rows], terminated[rows], truncated[rows] = 0.0, False, False
        self.ended = terminated | truncated
        return self.episodes.observe(), rewards, terminated, truncated, {}
