"""Maximum reachable workspace: distances of the tip from the system's centre of mass.

While no external force acts, the centre of mass does not move. Seen from there, the tip is the end
of a virtual manipulator with the arm's joint angles and shorter links (Vafa and Dubowsky 1990),

    b_i^VM = b_i (m_0 + .. + m_i) / m_tot                                              (Eq. 11)
    g_i^VM = g_i (m_0 + .. + m_{i-1}) / m_tot                                          (Eq. 12)
    R = sum over i = 0 .. n of b_i^VM + g_i^VM                                         (Eq. 13)

Cyclic motion of the arm can turn the base to any attitude. So the workspace is a disc of radius R
about the centre of mass, minus a hole if the joint limits leave one.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_model.layout import (
    COM_X,
    COM_Y,
    LATERAL,
    LENGTH,
    LINK_MASS,
    MASS,
    MOUNT_X,
    MOUNT_Y,
    G,
    each,
)
from fss_arm_workspace.regions.arcs import Region
from fss_arm_workspace.regions.fixed import chain_workspace, checked_limits


def virtual_links(p: npt.ArrayLike) -> tuple[Floats, Floats, Complexes]:
    """Return the virtual manipulator's b_i^VM and g_i^VM (Eq. 11, 12), and its links as vectors.

    Body 0 is the base: b_0 is from its centre of mass to joint 1, g_0 is 0. If a centre of mass
    lies beside its link's line, the virtual link is bent. Otherwise it is b_i^VM + g_i^VM along the
    link.

    Args:
        p: parameters of the arm, Arm.vector(), (..., 8 + 6 n).

    Returns:
        (..., n + 1) each [m]; the vectors are complex, each in its body's frame.
    """
    p = np.asarray(p, dtype=float)
    masses = np.concatenate([p[..., MASS, None], each(p, LINK_MASS)], axis=-1)
    inner = np.cumsum(masses, axis=-1) / masses.sum(axis=-1, keepdims=True)
    zero = np.zeros_like(inner[..., :1])
    inner_before = np.concatenate([zero, inner[..., :-1]], axis=-1)
    mount = p[..., MOUNT_X] - p[..., COM_X] + 1j * (p[..., MOUNT_Y] - p[..., COM_Y])
    b = np.concatenate([np.abs(mount)[..., None], each(p, LENGTH) - each(p, G)], axis=-1) * inner
    g = np.concatenate([zero, each(p, G)], axis=-1) * inner_before
    vectors = (b + g).astype(complex)
    vectors[..., 0] = mount * inner[..., 0]
    vectors[..., 1:] -= 1j * each(p, LATERAL) * (inner - inner_before)[..., 1:]
    return b, g, vectors


@dataclass(frozen=True)
class VirtualManipulator:
    """Virtual manipulator of an arm on a free base."""

    arm: Arm

    @property
    def b(self) -> Floats:
        """b_i^VM, (n + 1,) [m] (Eq. 11)."""
        return virtual_links(self.arm.vector())[0]

    @property
    def g(self) -> Floats:
        """g_i^VM, (n + 1,) [m] (Eq. 12)."""
        return virtual_links(self.arm.vector())[1]

    @property
    def links(self) -> Complexes:
        """Links as vectors in their bodies' frames, complex (n + 1,) [m]."""
        return virtual_links(self.arm.vector())[2]

    @property
    def radius(self) -> float:
        """Length R of the virtual manipulator [m] (Eq. 13)."""
        return float(np.abs(self.links).sum())

    def workspace(self, limits: npt.ArrayLike | None = None) -> Region:
        """Return the tip's workspace relative to the system's centre of mass, in base axes.

        Args:
            limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.

        Raises:
            ValueError: limits have the wrong shape or order.
        """
        base, *links = self.links
        bends = np.angle(links)
        offsets = np.array([link.theta_0 for link in self.arm.links]) + np.diff(bends, prepend=0.0)
        offsets[0] += self.arm.base.mount[2]
        return chain_workspace(base, np.abs(links), offsets, checked_limits(self.arm, limits))

    def reach(self, limits: npt.ArrayLike | None = None) -> tuple[float, float]:
        """Return the least and greatest distance of the tip from the system's centre of mass [m].

        The greatest is R if the joint limits allow the virtual manipulator to be straight.

        Raises:
            ValueError: limits have the wrong shape or order.
        """
        return self.workspace(limits).extent(0.0)


def base_mass_for(arm: Arm, radius: float) -> float:
    """Return the base's mass [kg] for which R of Eq. 13 equals `radius` [m].

    Raises:
        ValueError: there is no such mass; the message gives the possible range of R.
    """
    from scipy.optimize import brentq

    def excess(log_mass: float) -> float:
        base = replace(arm.base, mass=float(np.exp(log_mass)))
        return VirtualManipulator(replace(arm, base=base)).radius - radius

    total = sum(link.mass for link in arm.links)
    light, heavy = np.log(total) - 20.0, np.log(total) + 20.0
    if not excess(light) < 0.0 < excess(heavy) < inf:
        lowest, highest = excess(light) + radius, excess(heavy) + radius
        raise ValueError(f"radius is {radius} m, expected between {lowest:.4g} and {highest:.4g} m")
    return float(np.exp(brentq(excess, light, heavy, xtol=1e-12)))
