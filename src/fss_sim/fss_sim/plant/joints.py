"""What the joints are made of: motors, gears, friction, end stops."""

from dataclasses import dataclass

from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, setting


@dataclass(frozen=True)
class Joints(Settings):
    """The mechanics that all joints have in common."""

    rotor_inertia: float = setting(
        0.0, "inertia of each motor, felt at its joint, 0.0026 in the FHA-8C-30; 0: none",
        unit="kg m^2", check=NOT_NEGATIVE,
    )  # fmt: skip
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

    @property
    def rotor(self) -> tuple[float, float]:
        """N^2 J and N J [kg m^2], of an inertia J that turns N times as fast as the joint."""
        return self.rotor_inertia, self.rotor_inertia / self.gear_ratio
