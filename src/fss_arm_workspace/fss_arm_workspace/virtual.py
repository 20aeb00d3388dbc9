"""How far the tip can be from the system's centre of mass: the maximum reachable workspace.

While no external force acts, the centre of mass stays where it is. Seen from there, the tip is the
end of a virtual manipulator with the arm's joint angles and shorter links (Vafa and Dubowsky 1990),

    b_i^VM = b_i (m_0 + .. + m_i) / m_tot                                              (Eq. 11)
    g_i^VM = g_i (m_0 + .. + m_{i-1}) / m_tot                                          (Eq. 12)
    R = sum over i = 0 .. n of b_i^VM + g_i^VM                                         (Eq. 13)

Cyclic motion of the arm can turn the base to any attitude, so that the workspace is a disc of
radius R about the centre of mass, less a hole where the joint limits leave one.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from fss_arm_model.description import Arm

from .arcs import Complexes, Floats, Region
from .fixed import chain_workspace, checked_limits


@dataclass(frozen=True)
class VirtualManipulator:
    """The virtual manipulator of an arm on a free base; body 0 is the base."""

    arm: Arm

    @cached_property
    def b(self) -> Floats:
        """b_i^VM, (n + 1,) [m] (Eq. 11). b_0 is from the base's centre of mass to joint 1."""
        x, y, _ = self.arm.base.mount
        com_x, com_y = self.arm.base.com
        lengths = [np.hypot(x - com_x, y - com_y), *(link.b for link in self.arm.links)]
        return np.array(lengths) * self._inner[1:]

    @cached_property
    def g(self) -> Floats:
        """g_i^VM, (n + 1,) [m] (Eq. 12); g_0 is 0, as nothing comes before the base."""
        return np.array([0.0, *(link.g for link in self.arm.links)]) * self._inner[:-1]

    @property
    def links(self) -> Complexes:
        """The links as vectors in their bodies' frames, complex (n + 1,) [m].

        A centre of mass to the side of its link's line bends the virtual link; without, it is
        b_i^VM + g_i^VM along the link.
        """
        x, y, _ = self.arm.base.mount
        com_x, com_y = self.arm.base.com
        bend = np.array([link.lateral for link in self.arm.links]) * -np.diff(self._inner[1:])
        arm = self.b[1:] + self.g[1:] + 1j * bend
        return np.append(complex(x - com_x, y - com_y) * self._inner[1], arm)

    @property
    def radius(self) -> float:
        """R, the virtual manipulator's length [m] (Eq. 13)."""
        return float(np.abs(self.links).sum())

    def workspace(self, limits: npt.ArrayLike | None = None) -> Region:
        """Where the tip can be in axes of the base's frame through the system's centre of mass.

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
        """Least and greatest distance of the tip from the system's centre of mass [m].

        The greatest is R where the joint limits let the virtual manipulator be straight.

        Raises:
            ValueError: limits have the wrong shape or order.
        """
        return self.workspace(limits).extent(0.0)

    @cached_property
    def _inner(self) -> Floats:
        """Share of the mass in the bodies before body i, (n + 2,), from 0 to 1."""
        masses = [self.arm.base.mass, *(link.mass for link in self.arm.links)]
        return np.append(0.0, np.cumsum(masses)) / np.sum(masses)


def base_mass_for(arm: Arm, radius: float) -> float:
    """The base's mass [kg] with which R of Eq. 13 becomes `radius` [m].

    Raises:
        ValueError: no mass does; the message tells between which radii R can be.
    """

    def excess(log_mass: float) -> float:
        base = replace(arm.base, mass=float(np.exp(log_mass)))
        return VirtualManipulator(replace(arm, base=base)).radius - radius

    total = sum(link.mass for link in arm.links)
    light, heavy = np.log(total) - 20.0, np.log(total) + 20.0
    if not excess(light) < 0.0 < excess(heavy) < inf:
        least, most = excess(light) + radius, excess(heavy) + radius
        raise ValueError(f"radius is {radius} m, expected between {least:.4g} and {most:.4g} m")
    return float(np.exp(brentq(excess, light, heavy, xtol=1e-12)))
