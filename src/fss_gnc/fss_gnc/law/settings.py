"""Parameters of the node `controller`."""

from dataclasses import dataclass

from fss_arm_model.extents import Extents
from fss_arm_model.settings import POSITIVE, Settings, between, like, setting
from fss_arm_model.vehicle import Vehicle


@dataclass(frozen=True)
class ControllerSettings(Settings):
    """Parameters of a ControllerNode."""

    law: str = setting(
        "", "control law: MODULE:CLASS, FILE.py:CLASS, LIBRARY.so or FILE.fmu; required"
    )
    rate: float = setting(50.0, "steps of the law per second", unit="Hz", check=between(1.0, 1e3))
    time_to_live: float = setting(
        0.3,
        "lifetime of a command, from the time of its inputs; then valves close and joints stop",
        unit="s",
        check=POSITIVE,
    )
    arm: str = setting(
        "",
        "arm: file or built in (paper, cad, truth); empty: paper; calibrations are ignored",
    )
    table: tuple[float, ...] = like(Extents, "table")
    base_frame: str = like(Vehicle, "base_frame")
