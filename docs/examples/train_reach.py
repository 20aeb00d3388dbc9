"""Train a policy for FssReach-v0 in hindsight, and compare it with the generalized Jacobian.

    python train_reach.py [--arm ARM] [--minutes 3] [--seed 1] [--output reach.npz]

Arms on floating bases move, half of them to random postures, half by the policy. Had the fixture
been where an end effector came to, its motion would have been right (Ghosh et al. 2021). So a
network learns, from the joints' angles and the end effector's displacement to a later state, the
travel of the joints in between. It needs no reward, and no model but the environment.

The policy moves the joints straight along this travel, which it predicts again in each period. The
network's output is per displacement, so that its error vanishes at the fixture.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from time import process_time

import gymnasium
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.momentum import generalized_jacobian
from fss_sim.environments.batch import PERIOD, Batch, rotated, wrapped
from fss_sim.environments.register import register_environments
from fss_sim.environments.tasks import Reach, draw_postures

GAIN = 2.0  # rate per remaining travel or error, of both laws [1/s]
SPEED, DAMPING = 0.3, 0.05  # of the generalized Jacobian's end effector [m/s], of its inverse [m]
LENGTH = 0.2  # of an error of 1 rad, as in the reward [m]
HIDDEN = 128  # size of each of the two hidden layers
ARMS, PERIODS = 256, 40  # of a round of motions
UPDATES, PAIRS = 16, 1024  # of the network after a round; pairs of states of each
MAX_OUTPUT = 20.0  # of the network [rad/m]
LEARNING_RATE = 2e-3

Law = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Policy:
    """Law of a network with two hidden layers.

    Args:
        weights: matrix and offsets of each layer.
        max_rate: (n,) largest rates of the joints [rad/s].
    """

    def __init__(self, weights: list[np.ndarray], max_rate: np.ndarray) -> None:
        self.weights, self.max_rate = weights, max_rate

    def __call__(self, q: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return the rates of the joints (N, n) [rad/s].

        Args:
            q: (N, n) angles of the joints [rad].
            offset: (N, 3) fixture from the end effector, along the base's axes [m, m, rad].
        """
        inputs, size = features(q, offset)
        return limited(GAIN * size * self.layers(inputs)[-1], self.max_rate)

    def layers(self, inputs: np.ndarray) -> list[np.ndarray]:
        """Return the inputs, the values of both hidden layers, and the output."""
        matrix_1, offset_1, matrix_2, offset_2, matrix_3, offset_3 = self.weights
        first = np.tanh(inputs @ matrix_1 + offset_1)
        second = np.tanh(first @ matrix_2 + offset_2)
        return [inputs, first, second, second @ matrix_3 + offset_3]

    def gradients(self, inputs: np.ndarray, desired: np.ndarray) -> list[np.ndarray]:
        """Return the gradient of half the mean square error by each of the weights."""
        *below, output = self.layers(inputs)
        slope, gradients = (output - desired) / len(inputs), []
        for k in (2, 1, 0):
            gradients = [below[k].T @ slope, slope.sum(axis=0), *gradients]
            slope = (slope @ self.weights[2 * k].T) * (1.0 - below[k] ** 2)
        return gradients


def features(q: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the inputs of the network, and the size of the offset (N, 1) [m]."""
    error = np.column_stack([offset[:, :2], LENGTH * wrapped(offset[:, 2])])
    size = np.maximum(np.linalg.norm(error, axis=1, keepdims=True), 1e-6)
    inputs = np.hstack([error / size, np.log(size), np.sin(q), np.cos(q)])
    return inputs.astype(np.float32), size


def limited(rates: np.ndarray, max_rate: np.ndarray) -> np.ndarray:
    """Return the rates, those of an arm reduced together."""
    return rates / np.maximum(np.abs(rates / max_rate).max(axis=1, keepdims=True), 1.0)


def jacobian_law(arm: Arm) -> Law:
    """Return resolved rates by the damped generalized Jacobian."""
    p, weights = arm.vector(), np.array([1.0, 1.0, LENGTH])
    max_rate = np.array([link.drive.max_velocity for link in arm.links])

    def law(q: np.ndarray, offset: np.ndarray) -> np.ndarray:
        state = np.hstack([np.zeros((len(q), 3)), q])  # in the base's axes
        J = weights[:, None] * generalized_jacobian(p, state)
        twist = GAIN * weights * offset
        twist /= np.maximum(np.linalg.norm(twist, axis=1, keepdims=True) / SPEED, 1.0)
        square = J @ J.transpose(0, 2, 1) + DAMPING**2 * np.eye(3)
        rates = J.transpose(0, 2, 1) @ np.linalg.solve(square, twist[..., None])
        return limited(rates[..., 0], max_rate)

    return law


def train(arm: Arm, rng: np.random.Generator, shares: Iterable[float]) -> Policy:
    """Return a policy, trained by a round for each of the shares of the training, from 0 to 1."""
    n, task = arm.n, Reach(Batch(arm, ARMS))
    sizes = 3 + 1 + 2 * n, HIDDEN, HIDDEN, n
    weights = []
    for size, after in pairwise(sizes):
        weights += [rng.normal(0.0, size**-0.5, (size, after)), np.zeros(after)]
    policy = Policy([w.astype(np.float32) for w in weights], task.batch.max_rate)
    moments = [np.zeros((2, *w.shape), np.float32) for w in policy.weights]
    k = 0  # number of updates
    for share in shares:
        states = motions(task, policy, rng)
        for _ in range(UPDATES):  # by Adam (Kingma and Ba 2015)
            k += 1
            gradients = policy.gradients(*pairs(*states, rng))
            rate = LEARNING_RATE * (1.0 - share) / (1.0 - 0.9**k)
            for w, gradient, (mean, square) in zip(policy.weights, gradients, moments, strict=True):
                mean += 0.1 * (gradient - mean)
                square += 0.001 * (gradient**2 - square)
                w -= rate * mean / (np.sqrt(square / (1.0 - 0.999**k)) + 1e-8)
    return policy


def motions(
    task: Reach, policy: Policy, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joint angles, base headings and end effectors' poses, (PERIODS, ARMS, ...)."""
    batch, rows = task.batch, np.arange(ARMS)
    task.reset(rows, rng)
    travel = draw_postures(batch, ARMS, rng) - batch.q[:, 3:]
    rates = limited(travel / (PERIOD * PERIODS), batch.max_rate)
    states = []
    for _ in range(PERIODS):
        pose, _ = batch.tip()
        states.append((batch.q[:, 3:], batch.q[:, 2], pose))
        by_policy = policy(batch.q[:, 3:], rotated(task.fixture - pose, -batch.q[:, 2]))
        task.step(np.where(rows[:, None] % 2, rates, by_policy) / batch.max_rate)
    q, heading, pose = map(np.array, zip(*states, strict=True))
    return q, heading, pose


def pairs(
    q: np.ndarray, heading: np.ndarray, pose: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and desired outputs of the network for pairs of states of the same arm.

    Most pairs are near each other. The second may be the earlier one: without thrusters, a motion
    backwards takes the base back, too.
    """
    row, start = rng.integers(ARMS, size=PAIRS), rng.integers(PERIODS, size=PAIRS)
    end = np.rint(start + (PERIODS - 1) * rng.uniform(-1.0, 1.0, PAIRS) ** 3).astype(int)
    end = np.clip(end, 0, PERIODS - 1)
    offset = rotated(pose[end, row] - pose[start, row], -heading[start, row])
    inputs, size = features(q[start, row], offset)
    moved = size[:, 0] > 1e-3
    travel = (q[end, row] - q[start, row]) / size
    return inputs[moved], np.clip(travel, -MAX_OUTPUT, MAX_OUTPUT)[moved].astype(np.float32)


def evaluate(law: Law, arm: str, episodes: int = 1000, seed: int = 10**6) -> np.ndarray:
    """Return the share of arrivals [%] and, of those, time [s], rms and largest torque [N m].

    The time is the median and the 90th percentile; the largest torque of an episode the median.
    """
    envs = gymnasium.make_vec("FssReach-v0", num_envs=episodes, arm=arm)
    observation, _ = envs.reset(seed=seed)
    batch, n = envs.episodes.task.batch, envs.episodes.arm.n
    flying, (time, square, largest) = np.ones(episodes, dtype=bool), np.zeros((3, episodes))
    while flying.any() and time.max() < envs.episodes.task.duration - 0.5 * PERIOD:
        x, y, cosine, sine = observation[:, -4:].T
        offset = np.column_stack([x, y, np.arctan2(sine, cosine)])
        observation, _, arrived, *_ = envs.step(law(observation[:, :n], offset) / batch.max_rate)
        time[flying] += PERIOD
        square += flying * np.sum(batch.torque**2, axis=1) / n
        largest = np.maximum(largest, flying * np.abs(batch.torque).max(axis=1))
        flying &= ~arrived
    there = ~flying
    rms = np.sqrt(PERIOD * square[there].sum() / time[there].sum())
    times = np.percentile(time[there], [50, 90])
    return np.array([100.0 * there.mean(), *times, rms, np.median(largest[there])])


def elapsed(minutes: float) -> Iterator[float]:
    """Yield the elapsed share of some minutes of processor time, and show it."""
    start = process_time()
    with Progress() as progress:
        bar = progress.add_task("training", total=1.0)
        while (share := (process_time() - start) / (60.0 * minutes)) < 1.0:
            progress.update(bar, completed=share)
            yield share


def save(policy: Policy, file: str) -> None:
    """Write a policy to an .npz file."""
    np.savez(file, *policy.weights, max_rate=policy.max_rate)


def load(file: str) -> Policy:
    """Return the policy of a file."""
    with np.load(file) as arrays:
        return Policy([arrays[f"arr_{k}"] for k in range(6)], arrays["max_rate"])


def main() -> None:
    """Train, save, and print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arm", default="paper", help="paper, cad, truth (simulator) or a file")
    parser.add_argument("--minutes", type=float, default=3.0, help="processor time of training")
    parser.add_argument("--seed", type=int, default=1, help="of all random numbers")
    parser.add_argument("--output", default="reach.npz", help="file for the policy")
    options = parser.parse_args()
    arm = described(options.arm)
    policy = train(arm, np.random.default_rng(options.seed), elapsed(options.minutes))
    save(policy, options.output)
    register_environments()
    heads = "arrivals [%]", "median time [s]", "90 % [s]", "rms torque [N m]", "largest"
    table = Table("law", *heads)
    for name, law in {"policy": policy, "Jacobian": jacobian_law(arm)}.items():
        table.add_row(name, *map("{:.4g}".format, evaluate(law, options.arm)))
    Console().print(table)


if __name__ == "__main__":
    main()
