"""Parameters of a WorkspaceNode."""

from dataclasses import dataclass

from fss_arm_model.settings import POSITIVE, like, setting
from fss_arm_model.vehicle import Vehicle
from fss_arm_workspace.analysis import AnalysisSettings


@dataclass(frozen=True)
class WorkspaceSettings(AnalysisSettings):
    """Parameters of a WorkspaceNode: computation, topics and frames."""

    arm: str = setting(
        "",
        "arm until a calibration passes: file or built in (paper, cad, truth); empty: paper",
    )
    rate: float = setting(10.0, "rate of the ellipsoids", unit="Hz", check=POSITIVE)
    scale: float = setting(0.25, "size of drawn ellipsoids", unit="m/(m/rad)", check=POSITIVE)
    base_frame: str = like(Vehicle, "base_frame")
    world_frame: str = setting(
        "world", "frame id of straight paths, once a pose of the base is received"
    )
    base_topic: str = like(Vehicle, "base_topic")
