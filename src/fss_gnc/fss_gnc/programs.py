"""Executables that run the nodes."""

from fss_arm_ros.program import Program

control = Program("fss_gnc.control_node:ControlNode", "fss_gnc.control.settings:ControlSettings")
controller = Program(
    "fss_gnc.controller_node:ControllerNode", "fss_gnc.law.settings:ControllerSettings"
)
guidance = Program(
    "fss_gnc.guidance_node:GuidanceNode",
    "fss_gnc.guidance.mission_settings:MissionSettings",
)
navigation = Program(
    "fss_gnc.navigation_node:NavigationNode",
    "fss_gnc.navigation.settings:NavigationSettings",
)
