"""Executables that run nodes."""

from fss_arm_ros.program import Program

base_reaction = Program(
    "fss_arm_view.base_reaction_node:BaseReactionNode",
    "fss_arm_view.settings:BaseReactionSettings",
)
view = Program("fss_arm_view.view_node:make_nodes", "fss_arm_view.settings:ViewSettings")
