"""Steps per second of FssReach-v0 as a batch, and of the same task in MuJoCo by SyncVectorEnv.

One process, processor time; medians over interleaved runs. Exits with 1 if a batch of 256 is less
than 25 times as fast as MuJoCo's environments.
"""

import sys
from pathlib import Path
from statistics import median
from time import process_time

import gymnasium
from gymnasium.vector import SyncVectorEnv

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from mujoco_reach import MujocoReach

from fss_sim.environments.register import register_environments

COUNTS, STEPS, RUNS = (1, 16, 256), 50, 7
REQUIRED = 25.0  # ratio for the largest batch


def rate(envs: gymnasium.vector.VectorEnv, steps: int) -> float:
    """Return steps of single environments per second of processor time, with random actions."""
    actions = [envs.action_space.sample() for _ in range(steps)]
    start = process_time()
    for action in actions:
        envs.step(action)
    return steps * envs.num_envs / (process_time() - start)


def main() -> int:
    """Print the table; return the exit code."""
    register_environments()
    print("environments  ours [steps/s]  MuJoCo [steps/s]  ratio")
    ratio = 0.0
    for count in COUNTS:
        ours = gymnasium.make_vec("FssReach-v0", num_envs=count)
        peer = SyncVectorEnv([MujocoReach] * count)
        for envs in (ours, peer):
            envs.reset(seed=1)
            rate(envs, 3)  # kernels are loaded
        peer_steps = max(4, STEPS * 8 // count)
        runs = [(rate(ours, STEPS), rate(peer, peer_steps)) for _ in range(RUNS)]
        ratio = median(a / b for a, b in runs)
        ours_rate, peer_rate = (median(column) for column in zip(*runs, strict=True))
        print(f"{count:12}  {ours_rate:14,.0f}  {peer_rate:16,.0f}  {ratio:5.1f}")
    print(f"at least {REQUIRED:g} times for {COUNTS[-1]}: {'yes' if ratio >= REQUIRED else 'no'}")
    return int(ratio < REQUIRED)


if __name__ == "__main__":
    sys.exit(main())
