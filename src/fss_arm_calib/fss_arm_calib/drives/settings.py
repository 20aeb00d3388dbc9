"""Settings of a calibration of drives."""

from dataclasses import dataclass
from typing import ClassVar

from fss_arm_calib.segments.settings import ExcitationSettings, positive
from fss_arm_calib.settings import KindSettings, max_data
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, setting


@dataclass(frozen=True)
class DrivesSettings(ExcitationSettings, KindSettings):
    """Settings of a calibration of drives: excitations, prior knowledge and criteria."""

    ABOUT: ClassVar = (
        "Torque constant, friction and torque sensor of each joint, from its link's telemetry "
        "while joints turn."
    )

    arm: str = setting(
        "", "description YAML; its masses are taken as known; empty: the paper's arm"
    )
    max_excitations: int = max_data(600, "averages (over `window`)")
    gear_ratio: float = setting(30.0, "gear ratio of the harmonic drives", check=POSITIVE)
    window: float = positive(1.6, "s", "averaging time of torques and motion")
    rotor_inertia: float = setting(
        0.0026,
        "inertia of each rotor, seen at its joint; with 67 Hz of telemetry it is estimated",
        unit="kg m^2",
        check=NOT_NEGATIVE,
    )
    max_relative: float = setting(
        0.1,
        "largest accepted relative 1 sigma of a torque constant, friction or gain of a torque "
        "sensor; less certain ones are not reported",
        check=NOT_NEGATIVE,
    )

    @property
    def periods(self) -> float:
        """Periods of the encoder's error and of the torque ripple per turn of the joint."""
        return 2.0 * self.gear_ratio
