"""The parameters of a WorkspaceNode."""

from dataclasses import dataclass

from fss_arm_model.settings import setting

from .analysis import AnalysisSettings
from .straight_path import Rules


@dataclass(frozen=True)
class WorkspaceSettings:
    """What is computed, from which topics, and in which frames it is published.

    Raises:
        ValueError: a setting is impossible.
    """

    arm: str = setting("", "description YAML until a calibration comes; empty: the paper's arm")
    cell: float = setting(AnalysisSettings.cell, "size of the maps' cells [m]")
    directions: int = setting(AnalysisSettings.directions, "of straight paths, to begin with")
    redundancy: str = setting(Rules.redundancy, "rule by which straight paths use the redundancy")
    gain: float = setting(Rules.gain, "pull away from limits, at a limit [rad/m]")
    stopping_rate: float = setting(
        Rules.stopping_rate, "joint rate on a straight path that counts as a singularity [rad/m]"
    )
    table: tuple[float, ...] = setting(Rules.table, "low x, low y, high x, high y [m]")
    of_true_angle: bool = setting(False, "joint limits hold for q + theta_0, not for q")
    workers: int = setting(1, "threads for the maps")
    moved: float = setting(0.02, "change of a joint [rad] or of the base [m, rad] that counts")
    rate: float = setting(10.0, "of the ellipsoids [1/s]")
    scale: float = setting(0.25, "of ellipsoids as drawn [m per m/rad]")
    base_frame: str = setting("fss", "frame id of workspace, maps and ellipsoids")
    world_frame: str = setting("world", "frame id of straight paths, once a pose of the base came")
    joints_topic: str = setting("joint_states", "readings of joint_1 .. joint_n")
    base_topic: str = setting("vicon/fss/fss", "poses of the base")

    def __post_init__(self) -> None:
        for name in ("moved", "rate", "scale"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        _ = self.analysis  # which refuses what it must

    @property
    def analysis(self) -> AnalysisSettings:
        """What the mathematics takes."""
        rules = Rules(
            redundancy=self.redundancy,
            gain=self.gain,
            stopping_rate=self.stopping_rate,
            table=self.table,
        )
        return AnalysisSettings(self.cell, self.directions, rules, self.of_true_angle, self.workers)
