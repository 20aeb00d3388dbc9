"""Parameters of the node `control`."""

from dataclasses import dataclass

from fss_arm_model.extents import Extents
from fss_arm_model.held import Target
from fss_arm_model.settings import POSITIVE, between, like, setting
from fss_arm_model.vehicle import Vehicle
from fss_gnc.control.pose import PoseGains


@dataclass(frozen=True)
class ControlSettings(PoseGains):
    """Parameters of a ControlNode."""

    arm: str = setting(
        "",
        "arm: file or built in (paper, cad, truth); empty: paper; calibrations are ignored",
    )
    rate: float = setting(
        10.0, "publishing rate of base/wrench", unit="Hz", check=between(1.0, 200.0)
    )
    timeout: float = setting(
        1.0,
        "time after which a base/trajectory expires unless it is repeated; then the valves close",
        unit="s",
        check=POSITIVE,
    )
    max_age: float = setting(
        0.5,
        "age of base/state beyond which the valves close, and of arm/joint_states beyond which the "
        "joints are assumed at rest",
        unit="s",
        check=POSITIVE,
    )
    max_pause: float = setting(
        0.5,
        "longest pause of this process in real time, as on a busy computer; after a longer "
        "one the base is held and guidance's action ends",
        unit="s",
        check=POSITIVE,
    )
    feed_forward: bool = setting(
        True, "whether to compensate the arm's planned reaction by feedforward"
    )
    table: tuple[float, ...] = like(Extents, "table")
    full_tank: float = like(Vehicle, "full_tank")
    target_mass: float = like(Target, "mass")
    target_inertia: float = like(Target, "inertia")
    base_frame: str = like(Vehicle, "base_frame")
