"""Executables of this package."""

from fss_arm_ros.program import Command, Program

workspace = Program(
    "fss_arm_workspace.workspace_node:make_node",
    "fss_arm_workspace.settings:WorkspaceSettings",
)
workspace_map = Command("fss_arm_workspace.map:main", "fss_arm_workspace.map_options:parser")
