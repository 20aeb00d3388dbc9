"""Executables of the package."""

from fss_arm_ros.program import Command, Program

base = Program(
    "fss_base_driver.base_node:BaseNode",
    "fss_base_driver.settings:BaseSettings",
    live="fss_base_driver.settings:live_kinds",
)
fog = Program(
    "fss_base_driver.fog_node:FogNode",
    "fss_base_driver.settings:FogSettings",
    live="fss_base_driver.settings:live_fog_kinds",
)
mocap = Program("fss_base_driver.mocap_node:MocapNode", "fss_base_driver.settings:MocapSettings")
check = Command("fss_base_driver.check_command:main", "fss_base_driver.check_options:parser")
subjects = Command("fss_base_driver.subjects_node:main", "fss_base_driver.subjects_options:parser")
