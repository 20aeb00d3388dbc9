"""Layout of Arm.vector(), p (..., 8 + 6 n); no other module defines it.

The base's numbers come first. Those of link k, from 1, are at LINK_SIZE k plus their constant:

    p[MASS], p[LINK_SIZE * k + LINK_MASS]

Constants and functions are plain Python, so that a description needs no compiler. Kernels use the
constants unchanged and the functions compiled, as `helper(mass)`. Body 0 is the base, body k
link k; vectors in the plane are complex numbers, in their body's own frame [m].
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats

BASE_SIZE, LINK_SIZE = 8, 6
MASS, INERTIA, COM_X, COM_Y, MOUNT_X, MOUNT_Y, MOUNT_ANGLE, TIP_ANGLE = range(BASE_SIZE)
LENGTH, OFFSET, LINK_MASS, LINK_INERTIA, G, LATERAL = range(BASE_SIZE - LINK_SIZE, BASE_SIZE)


def size(n: int) -> int:
    """Return the number of parameters of an arm of n links."""
    return BASE_SIZE + LINK_SIZE * n


def count(p: Floats) -> int:
    """Return the number of links of an arm."""
    return (p.shape[-1] - BASE_SIZE) // LINK_SIZE


def each(p: Floats, number: int) -> Floats:
    """Return one parameter (such as LENGTH) of every link: (..., n), a view."""
    return p[..., LINK_SIZE + number :: LINK_SIZE]


def mass(p: Floats, k: int) -> float:
    """Return the mass of body k [kg]."""
    return p[MASS] if k == 0 else p[LINK_SIZE * k + LINK_MASS]


def inertia(p: Floats, k: int) -> float:
    """Return the moment of inertia of body k about its centre of mass [kg m^2]."""
    return p[INERTIA] if k == 0 else p[LINK_SIZE * k + LINK_INERTIA]


def reach(p: Floats, k: int) -> complex:
    """Return the vector from the pivot of body k to the next one (for the last link: the tip)."""
    return complex(p[MOUNT_X], p[MOUNT_Y]) if k == 0 else complex(p[LINK_SIZE * k + LENGTH], 0.0)


def com(p: Floats, k: int) -> complex:
    """Return the vector from the pivot of body k to its centre of mass."""
    if k == 0:
        return complex(p[COM_X], p[COM_Y])
    return complex(p[LINK_SIZE * k + G], p[LINK_SIZE * k + LATERAL])


def kinematic_names(n: int) -> tuple[str, ...]:
    """Return names of the 2 n + 2 kinematic parameters of Eq. 1; theta_BJ1 includes theta_0_1."""
    lengths = (f"a_{i}" for i in range(1, n + 1))
    offsets = (f"theta_0_{i}" for i in range(2, n + 1))
    return (*lengths, *offsets, "x_BJ1", "y_BJ1", "theta_BJ1")


def kinematic_index(n: int) -> npt.NDArray[np.intp]:
    """Return the indices of the parameters of kinematic_names(n), (2 n + 2,)."""
    links = LINK_SIZE * np.arange(1, n + 1)
    mount = [MOUNT_X, MOUNT_Y, MOUNT_ANGLE]
    return np.concatenate([links + LENGTH, links[1:] + OFFSET, mount])
