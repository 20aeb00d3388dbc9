"""Executables that run nodes."""

from fss_arm_ros.program import Program

link = Program("fss_arm_driver.links_node:make_nodes", "fss_arm_driver.settings:LinkSettings")
arm = Program("fss_arm_driver.arm_node:ArmNode", "fss_arm_driver.settings:ArmSettings")
driver = Program("fss_arm_driver.driver_node:make_nodes", "fss_arm_driver.settings:DriverSettings")
