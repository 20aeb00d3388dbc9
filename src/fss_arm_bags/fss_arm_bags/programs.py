"""The executables."""

from fss_arm_ros.program import Command, Program

record = Program("fss_arm_bags.record_node:RecordNode", "fss_arm_bags.settings:RecordSettings")
replay = Program(
    "fss_arm_bags.replay_node:ReplayNode",
    "fss_arm_bags.settings:ReplaySettings",
    takes="BAG...",
    short={"--hold": "hold:=true"},
)
doctor = Command("fss_arm_bags.doctor.command:main", "fss_arm_bags.doctor.options:parser")
