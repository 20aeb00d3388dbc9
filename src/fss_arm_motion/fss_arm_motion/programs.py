"""The executables that run nodes."""

from fss_arm_ros.program import Program

motion = Program("fss_arm_motion.motion_node:MotionNode", "fss_arm_motion.settings:MotionSettings")
