"""Base and arm as heavy as they are now: less propellant, and with what the gripper holds."""

import numpy as np
import numpy.typing as npt

from fss_arm_model import layout
from fss_arm_model.held import Target, with_held

Floats = npt.NDArray[np.float64]


def present(p: Floats, used: float, target: Target, place: Floats | None) -> Floats:
    """Parameters of base and arm as they are now, as kernels take them.

    Args:
        p: (8 + 6 n,) as described.
        used: propellant that the base has no more [kg].
        target: what the gripper may hold.
        place: (3,) of it in the last link's frame (held.py); None: it holds nothing.
    """
    found = p.copy()
    found[layout.MASS] -= used
    return found if place is None else with_held(found, target, place)
