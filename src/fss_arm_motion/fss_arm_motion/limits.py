"""Limits of the joints: angles, rates, accelerations, torques with friction and rotors."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.free_floating import free_torques
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.settings import (
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    above,
    like,
    setting,
)
from fss_arm_model.units import angle_beyond

KINDS = (("rate", "rad/s"), ("acceleration", "rad/s^2"), ("torque", "N m"))


@dataclass(frozen=True)
class LimitSettings(Settings):
    """Settings of the limits for plans: share of the drives, friction, rotors and sizes.

    Raises:
        SettingError: friction leaves no torque.
    """

    share: float = setting(
        0.9,
        "share of the drives' rates, accelerations and torques that plans use",
        check=above(0.0, 1.0),
    )
    rotor_inertia: float = setting(
        0.0026, "inertia of each motor, felt at its joint", unit="kg m^2", check=NOT_NEGATIVE
    )
    gear_ratio: float = setting(30.0, "gear ratio of the harmonic drives", check=POSITIVE)
    viscous: float = setting(
        0.5, "viscous friction of each joint", unit="N m s/rad", check=NOT_NEGATIVE
    )
    coulomb: float = setting(0.3, "Coulomb friction of each joint", unit="N m", check=NOT_NEGATIVE)
    base_radius: float = like(GuardSettings, "base_radius")
    link_radius: float = like(GuardSettings, "link_radius")
    margin: float = like(GuardSettings, "margin")


@dataclass(frozen=True)
class Limits:
    """Limits of n joints."""

    bounds: Floats  # (n, 2) lowest and highest readings [rad]
    rate: Floats  # (n,) [rad/s]
    acceleration: Floats  # (n,) [rad/s^2]
    torque: Floats  # (n,) of the motors, at the joints, less Coulomb friction [N m]
    viscous: float  # [N m s/rad]
    rotor: Floats  # (2,) N^2 J and N J [kg m^2]
    radii: tuple[float, float]  # of the base and of links [m]
    margin: float  # between bodies that are not neighbours [m]

    @classmethod
    def of(cls, arm: Arm, settings: LimitSettings | None = None) -> "Limits":
        """Return the limits of an arm by its description.

        Raises:
            SettingError: friction leaves a joint no torque.
        """
        s = settings or LimitSettings()
        drives = [link.drive for link in arm.links]
        most = np.array([min(k.max_torque, k.torque_constant * k.max_current) for k in drives])
        if not ((available := s.share * most - s.coulomb) > 0.0).all():
            i = int(np.argmin(available))
            raise SettingError(
                f"coulomb is {s.coulomb:g} N m, expected less than the {s.share * most[i]:.4g} N m "
                f"that joint {i + 1} may use"
            )
        return cls(
            np.array([[link.q_min, link.q_max] for link in arm.links]),
            s.share * np.array([k.max_velocity for k in drives]),
            s.share * np.array([k.max_acceleration for k in drives]),
            available,
            s.viscous,
            np.array([s.rotor_inertia, s.rotor_inertia / s.gear_ratio]),
            (s.base_radius, s.link_radius),
            s.margin,
        )

    @property
    def table(self) -> Floats:
        """Limits as transcription.py takes them, (n, 4)."""
        viscous = np.full_like(self.rate, self.viscous)
        return np.column_stack([self.rate, self.acceleration, self.torque, viscous])

    def used(self, p: Floats, q: Floats, qd: Floats, qdd: Floats, momentum: float = 0.0) -> Floats:
        """Return the shares of rates, accelerations and torques used, (..., 3, n)."""
        tau = free_torques(p, q, qd, qdd, momentum, self.rotor)[0] + self.viscous * qd
        required = np.stack([qd, qdd, tau], axis=-2)
        return np.abs(required) / np.stack([self.rate, self.acceleration, self.torque])

    def outside(self, q: npt.ArrayLike, tolerance: float = 1e-9) -> str:
        """Return the first joint outside its angles, its value and the limits; empty: none."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        low, high = self.bounds.T
        for i in np.flatnonzero(((q < low - tolerance) | (q > high + tolerance)).any(axis=0)):
            worst = q[np.argmax(np.maximum(low[i] - q[:, i], q[:, i] - high[i])), i]
            return f"joint {i + 1} at {angle_beyond(worst, low[i], high[i])}"
        return ""
