"""Executables of this package."""

from fss_arm_ros.program import Command, Program

kinematic = Program(
    "fss_arm_calib.calibration_node:CalibrationNode",
    "fss_arm_calib.node_settings:KinematicNodeSettings",
    of="fss_arm_calib.kinds:KINEMATIC",
)
drives = Program(
    "fss_arm_calib.calibration_node:CalibrationNode",
    "fss_arm_calib.node_settings:DrivesNodeSettings",
    of="fss_arm_calib.kinds:DRIVES",
)
dynamic = Program(
    "fss_arm_calib.calibration_node:CalibrationNode",
    "fss_arm_calib.node_settings:DynamicNodeSettings",
    of="fss_arm_calib.kinds:DYNAMIC",
)
drift = Program(
    "fss_arm_calib.calibration_node:CalibrationNode",
    "fss_arm_calib.node_settings:DriftNodeSettings",
    of="fss_arm_calib.kinds:DRIFT",
)
joint = Program(
    "fss_arm_calib.calibration_node:CalibrationNode",
    "fss_arm_calib.node_settings:JointNodeSettings",
    of="fss_arm_calib.joint.kind:JOINT",
)
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
