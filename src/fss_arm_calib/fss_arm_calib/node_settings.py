"""Parameters of the calibration nodes."""

from dataclasses import dataclass
from typing import Any

from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_model.settings import Settings, setting


@dataclass(frozen=True)
class NodeSettings(Settings):
    """Parameters of a calibration node in addition to the settings of its kind."""

    frame_id: str = setting("", "frame id of the results; empty: the base's (of `drift`: world)")
    state_file: str = setting("", "file that keeps the data across restarts; empty: none")
    output: str = setting(
        "", "file for a passing result, a description (of `drift`: parameters); empty: none"
    )
    report: str = setting("", "folder for the report that ~/solve writes; empty: none")


def node_settings(name: str, kind: type[Settings]) -> type[Any]:
    """Return the class of a calibration node's parameters, given the kind's name and settings."""
    made = type(f"{name.title()}NodeSettings", (NodeSettings, kind), {})
    return dataclass(frozen=True)(made)


KinematicNodeSettings = node_settings("kinematic", KinematicSettings)
DynamicNodeSettings = node_settings("dynamic", DynamicSettings)
DriftNodeSettings = node_settings("drift", DriftSettings)
DrivesNodeSettings = node_settings("drives", DrivesSettings)
JointNodeSettings = node_settings("joint", JointSettings)
