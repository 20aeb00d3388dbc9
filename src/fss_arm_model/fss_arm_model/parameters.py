"""The parameters of an arm by name, and their relation to Arm.vector().

For an arm of n links they are, in this order,

    m_0, I_0, x_com, y_com        the base: mass, inertia, centre of mass in its frame
    kinematic_names(n)            a_i, theta_0_i, x_BJ1, y_BJ1, theta_BJ1
    m_1 .. m_n, b_1 .. b_n, I_1 .. I_n    the links: mass, centre of mass to the next joint, inertia

theta_0_1 is 0, as theta_BJ1 takes its place. Lateral offsets and theta_E are not among them.

On a known base, the motion depends on only 2 n + 1 combinations of those of the links (see
base_motion):

    m = sum_k m_k
    S_j = m_j g_j + a_j sum_{k>j} m_k
    K_j = I_j + m_j g_j^2 + a_j^2 sum_{k>j} m_k
"""

import re
from collections.abc import Collection
from dataclasses import replace
from functools import cache
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .description import Arm
from .layout import BASE_SIZE, LINK_SIZE, kinematic_index, kinematic_names

#: Meanings of symbols, by the pattern of the parameters' names.
MEANINGS = {
    r"m(_.+)?": "m: mass",
    r"I(_.+)?": "I: inertia about the centre of mass",
    r"b(_.+)?": "b: from a link's centre of mass to its outer joint or the tip",
    r"[xy]_com": "x_com, y_com: centre of mass in the base's frame",
    r"[mI]_0": "0: base",
    r"g_[xy]": "g_x, g_y: acceleration by the table's tilt",
    r"a(_.+)?": "a: length",
    r"theta_0_.+": "theta_0: encoder offset",
    r".+_BJ1": "BJ1: joint 1 in the base's frame",
    r"theta_E": "theta_E: heading of the end effector's markers",
}


def parameter_names(n: int) -> tuple[str, ...]:
    """Return the names of all 5 n + 6 parameters."""
    links = (f"{kind}_{i}" for kind in "mbI" for i in range(1, n + 1))
    return ("m_0", "I_0", "x_com", "y_com", *kinematic_names(n), *links)


def describe_symbols(names: Collection[str]) -> str:
    """Return the meanings of the symbols in the names of parameters; empty if none is known."""
    found = [MEANINGS[p] for p in MEANINGS if any(re.fullmatch(p, name) for name in names)]
    return "; ".join(found)


def unit(name: str) -> str:
    """Return the unit of a parameter."""
    kinds = {"m": "kg", "I": "kg m^2", "g": "m/s^2", "theta": "rad"}
    return kinds.get(name.split("_")[0], "m")


@cache
def to_vector(n: int) -> Floats:
    """Return the derivative of Arm.vector() by the parameters, (8 + 6 n, 5 n + 6); g = a - b."""
    T = np.zeros((BASE_SIZE + LINK_SIZE * n, 5 * n + 6))
    T[range(4), range(4)] = 1.0
    T[kinematic_index(n), range(4, 2 * n + 6)] = 1.0
    links, first = BASE_SIZE + LINK_SIZE * np.arange(n), 2 * n + 6 + np.arange(n)
    T[links + 2, first] = 1.0  # m_i
    T[links + 4, first + n] = -1.0  # g_i by b_i
    T[links + 4, 4 + np.arange(n)] = 1.0  # g_i by a_i
    T[links + 3, first + 2 * n] = 1.0  # I_i
    return T


def values(arm: Arm) -> Floats:
    """Return the parameters of an arm, (5 n + 6,)."""
    vector, links = arm.vector(), arm.links
    own = [[k.mass for k in links], [k.b for k in links], [k.inertia for k in links]]
    return np.concatenate([vector[:4], vector[kinematic_index(arm.n)], *own])


def bounds(arm: Arm) -> tuple[Floats, Floats]:
    """Return lower and upper bounds of an arm's parameters, (5 n + 6,) each.

    Masses, inertias and lengths are above 0, centres of mass between the link's joints.
    """
    n, lengths = arm.n, [link.a for link in arm.links]
    low = np.array([1e-6 if name[0] in "mIa" else -inf for name in parameter_names(n)])
    high = np.full(len(low), inf)
    low[3 * n + 6 : 4 * n + 6], high[3 * n + 6 : 4 * n + 6] = 0.0, lengths
    return low, high


def with_values(arm: Arm, v: npt.ArrayLike) -> Arm:
    """Return the arm with other values of the parameters, (5 n + 6,).

    Raises:
        DescriptionError: a value is invalid.
    """
    n, given = arm.n, np.asarray(v, dtype=float).tolist()
    arm = arm.with_kinematics(given[4 : 2 * n + 6])
    m, b, inertia = (given[2 * n + 6 + k * n : 3 * n + 6 + k * n] for k in range(3))
    links = tuple(
        replace(link, mass=m[i], b=b[i], inertia=inertia[i]) for i, link in enumerate(arm.links)
    )
    base = replace(arm.base, mass=given[0], inertia=given[1], com=(given[2], given[3]))
    return replace(arm, base=base, links=links)


def combinations(v: npt.NDArray[Any], n: int) -> npt.NDArray[Any]:
    """Return m, S_j and K_j, (2 n + 1,), of all parameters (5 n + 6,), real or complex."""
    a, m, b, inertia = v[4 : 4 + n], *v[2 * n + 6 :].reshape(3, n)
    g, beyond = a - b, np.cumsum(m[::-1])[::-1] - m
    return np.concatenate([[m.sum()], m * g + a * beyond, inertia + m * g**2 + a**2 * beyond])


def combination_gradients(arm: Arm) -> tuple[Floats, Floats]:
    """Return the 2 n + 1 combinations and their derivatives by the 5 n + 6 parameters.

    The derivatives are by complex steps, which are exact for polynomials.
    """
    v, step = values(arm), 1e-20
    steps = v + 1j * step * np.eye(len(v))
    columns = [combinations(one, arm.n).imag / step for one in steps]
    return combinations(v, arm.n), np.array(columns).T
