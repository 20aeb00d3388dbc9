"""Mechanical parameters of the joints: motors, gears, friction, end stops."""

from dataclasses import dataclass
from math import exp, expm1, pi, radians

import numpy as np

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.integration import STEP
from fss_arm_model.layout import LINK_MASS, MOUNT_ANGLE, OFFSET, com, each, reach
from fss_arm_model.settings import (
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    between,
    setting,
)
from fss_sim.plant.gears import GearParameters


@dataclass(frozen=True)
class Joints(Settings):
    """Mechanical parameters that all joints share."""

    rotor_inertia: float = setting(
        0.0,
        "inertia of each rotor, seen at its joint, 0.0026 for the FHA-8C-30; 0: none",
        unit="kg m^2",
        check=NOT_NEGATIVE,
    )
    gear_ratio: float = setting(30.0, "gear ratio of the harmonic drives", check=POSITIVE)
    viscous: float = setting(
        0.5, "viscous friction of each joint", unit="N m s/rad", check=NOT_NEGATIVE
    )
    coulomb: float = setting(0.3, "Coulomb friction of each joint", unit="N m", check=NOT_NEGATIVE)
    stop_stiffness: float = setting(
        2000.0, "stiffness of the joints' end stops", unit="N m/rad", check=NOT_NEGATIVE
    )
    stop_damping: float = setting(
        20.0, "damping of the joints' end stops", unit="N m s/rad", check=NOT_NEGATIVE
    )

    stiffness: float = setting(
        0.0,
        "stiffness of the harmonic drives, 340 to 440 for the FHA-8C-30; 0: rigid; needs "
        "rotor_inertia",
        unit="N m/rad",
        check=NOT_NEGATIVE,
    )
    damping: float = setting(
        0.0,
        "damping of a harmonic drive's twist; needs gear_stiffness",
        unit="N m s/rad",
        check=NOT_NEGATIVE,
    )
    dead_band: float = setting(
        0.0,
        "backlash of a harmonic drive, from end to end; needs gear_stiffness",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    static: float = setting(
        0.0,
        "static friction of a joint, if above its Coulomb friction; needs gear_stiffness",
        unit="N m",
        check=NOT_NEGATIVE,
    )
    stribeck_speed: float = setting(
        0.05,
        "speed at which 1/e of the excess of static friction is left",
        unit="rad/s",
        check=POSITIVE,
    )
    cancelled: float = setting(
        1.0,
        "share of viscous and Coulomb friction that a servo compensates; needs gear_stiffness",
        check=between(0.0, 1.0),
    )
    ripple: float = setting(
        0.0,
        "amplitude of the motors' torque ripple, two periods per motor turn; needs gear_stiffness",
        unit="N m",
        check=NOT_NEGATIVE,
    )
    current_bandwidth: float = setting(
        0.0,
        "bandwidth of the current loops; 0: without delay; needs gear_stiffness",
        unit="Hz",
        check=NOT_NEGATIVE,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stiffness and not self.rotor_inertia:
            raise SettingError(
                f"stiffness is {self.stiffness:g} N m/rad with a rotor_inertia of 0: flexible "
                "gears need a rotor_inertia above 0"
            )
        rigid = Joints.__dataclass_fields__
        needs = "damping", "dead_band", "static", "cancelled", "ripple", "current_bandwidth"
        for name in needs if not self.stiffness else ():
            if (value := getattr(self, name)) != rigid[name].default:
                raise SettingError(f"{name} is {value:g}, which needs a gear stiffness above 0")

    def gears(self, p: Floats) -> GearParameters:
        """Return the parameters of the gears, for p = Arm.vector()."""
        lag = 2.0 * pi * self.current_bandwidth * STEP  # a step over the loop's time constant
        mean, left = (1.0 + expm1(-lag) / lag, exp(-lag)) if lag else (1.0, 0.0)
        rest = each(p, OFFSET).copy()
        rest[:1] += p[MOUNT_ANGLE]
        return GearParameters(
            stiffness=self.stiffness,
            damping=self.damping,
            half_band=0.5 * self.dead_band,
            static=self.static,
            stribeck_speed=self.stribeck_speed,
            ripple=self.ripple,
            ripple_order=2.0 * self.gear_ratio,
            mean_response=mean,
            decay=left,
            cancelled=self.cancelled,
            rest=rest,
        )

    @property
    def rotor(self) -> tuple[float, float]:
        """N^2 J and N J [kg m^2], for a rotor of inertia J that turns N times as fast."""
        return self.rotor_inertia, self.rotor_inertia / self.gear_ratio


def outboard_momentum(p: Floats, q: Floats, qd: Floats) -> Floats:
    """Return the linear momentum of all links beyond each joint, (n, 2) [N s].

    Its change over time equals the impulse of the force that the joint transmits plus that of the
    external forces on these links.

    Args:
        p: (8 + 6 n,) Arm.vector().
        q: (3 + n,) state.
        qd: (3 + n,) its rate.
    """
    turns, spins = _directions(p, q), np.cumsum(qd[2:])
    arms = np.array([reach(p, k) for k in range(turns.size)]) * turns
    rates = complex(*qd[:2]) + np.concatenate([[0.0], np.cumsum(1j * spins * arms)[:-1]])
    centres = np.array([com(p, k) for k in range(turns.size)]) * turns
    momenta = each(p, LINK_MASS) * (rates + 1j * spins * centres)[1:]
    beyond = np.cumsum(momenta[::-1])[::-1]
    return np.column_stack([beyond.real, beyond.imag])


def link_normals(p: Floats, q: Floats) -> Floats:
    """Return the unit vectors perpendicular to each link, in the world frame, (n, 2)."""
    across = 1j * _directions(p, q)[1:]
    return np.column_stack([across.real, across.imag])


def _directions(p: Floats, q: Floats) -> Complexes:
    """Return exp(i psi) for base and links, (1 + n,)."""
    angles = q[2:].copy()
    angles[1:] += each(p, OFFSET)
    angles[1:2] += p[MOUNT_ANGLE]
    turns: Complexes = np.exp(1j * np.cumsum(angles))
    return turns


_REALISTIC = Joints(
    rotor_inertia=0.0026,
    stiffness=390.0,
    damping=1.0,
    dead_band=radians(60 / 3600),
    static=0.4,
    cancelled=0.9,
    ripple=0.02,
    current_bandwidth=300.0,
)

#: Joint presets, with the names of noise.PRESETS. Inertia and stiffness are those of the FHA-8C-30.
#: The other values are typical of such drives; they were not measured on the arm.
PRESETS = {
    "ideal": Joints(),
    "default": Joints(),
    "paper": Joints(),
    "laboratory": _REALISTIC,
}
