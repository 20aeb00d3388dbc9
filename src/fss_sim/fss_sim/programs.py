"""Executables that run the nodes."""

from fss_arm_ros.program import Program

testbed = Program("fss_sim.testbed_node:TestbedNode", "fss_sim.settings:TestbedSettings")
