"""Message of the base reaction."""

from fss_arm_msgs.msg import BaseReaction
from fss_arm_ros.convert import to_time

from .base_reaction import Reaction

# Fields common to a Reaction and its message.
VECTORS = (
    *("predicted", "predicted_deviation", "measured", "measured_deviation", "difference", "twist"),
    *("momentum", "momentum_deviation", "momentum_drift", "force", "q", "com"),
)


def reaction_message(reaction: Reaction, arm: str, world_frame: str) -> BaseReaction:
    """Return a reaction, predicted with an arm of this name, as a message."""
    message = BaseReaction(
        arm=arm,
        anchor=to_time(reaction.anchor),
        kinetic_energy=reaction.kinetic_energy,
        torque=reaction.torque,
        torque_measured=reaction.torque_measured,
        **{name: getattr(reaction, name).tolist() for name in VECTORS},
    )
    message.header.stamp, message.header.frame_id = to_time(reaction.t), world_frame
    return message
