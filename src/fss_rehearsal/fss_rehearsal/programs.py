"""Executables of this package."""

from fss_arm_ros.program import Command

campaign = Command("fss_rehearsal.campaign.command:main", "fss_rehearsal.campaign.options:parser")
