"""Validity rules of base/wrench: planar, finite, in the base's frame."""

from operator import attrgetter
from typing import Any

from fss_link.session import CommandError

IN_PLANE = "force.x", "force.y", "torque.z"
OUT_OF_PLANE = "force.z", "torque.x", "torque.y"
TOLERANCE = 1e-3  # limit of components out of the plane [N, N m]


def planar_wrench(message: Any, frame: str, limit: float) -> tuple[float, float, float]:
    """Return force along the base's x and y axes [N] and torque about its origin [N m].

    Args:
        message: geometry_msgs/WrenchStamped.
        frame: frame id of the base.
        limit: largest magnitude of a component [N, N m].

    Raises:
        CommandError: the frame id is not the base's, or a component is not finite, beyond the
            limit, or out of the plane.
    """
    if (given := message.header.frame_id) != frame:
        raise CommandError(f"frame_id is {given[:40]!r}, expected {frame!r}")
    for names, largest in ((IN_PLANE, limit), (OUT_OF_PLANE, TOLERANCE)):
        for name in names:
            value = attrgetter(name)(message.wrench)
            if not abs(value) <= largest:  # NaN, too
                unit = "N m" if name.startswith("torque") else "N"
                raise CommandError(
                    f"{name} is {value:g} {unit}, expected {-largest:g} to {largest:g} {unit}"
                )
    x, y, torque = attrgetter(*IN_PLANE)(message.wrench)
    return x, y, torque
