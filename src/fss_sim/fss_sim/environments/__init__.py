"""Gymnasium environments of the floating arm: FssReach-v0, FssHold-v0 and FssCapture-v0.

`gymnasium.make("fss_sim.environments:FssReach-v0")` makes one, `gymnasium.make_vec` with the same
name a batch that the compiled rollout advances in one call. See docs/how-to/learning.md.
"""

from fss_sim.environments.register import register

register()
