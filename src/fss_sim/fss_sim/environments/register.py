"""Names of the environments for `gymnasium.make` and `gymnasium.make_vec`.

`make` makes one, `make_vec` a batch that the compiled rollout advances in one call.
"""

import gymnasium

from fss_sim.environments.tasks import TASKS

WHERE = "fss_sim.environments.environment"


def register_environments() -> None:
    """Register each task as an environment; a second call changes nothing."""
    for name in TASKS:
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"{WHERE}:FloatingArmEnv",
                vector_entry_point=f"{WHERE}:FloatingArmVectorEnv",
                kwargs={"task": name},
            )
