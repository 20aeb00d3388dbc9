"""Executables of this package."""

from fss_arm_ros.program import Command, Program


def _calibration(kind: str, module: str = "kinds") -> Program:
    return Program(
        "fss_arm_calib.calibration_node:CalibrationNode",
        f"fss_arm_calib.node_settings:{kind.title()}NodeSettings",
        of=f"fss_arm_calib.{module}:{kind.upper()}",
    )


kinematic = _calibration("kinematic")
drives = _calibration("drives")
dynamic = _calibration("dynamic")
drift = _calibration("drift")
joint = _calibration("joint", "joint.kind")
experiment = Program(
    "fss_arm_calib.experiment.experiment_node:ExperimentNode",
    "fss_arm_calib.experiment.settings:ExperimentSettings",
)
design = Command(
    "fss_arm_calib.experiment.design_command:main",
    "fss_arm_calib.experiment.design_options:parser",
)
from_bag = Command("fss_arm_calib.from_bag:main", "fss_arm_calib.from_bag_options:parser")
recompute = Command("fss_arm_calib.recompute:main", "fss_arm_calib.recompute_options:parser")
