"""Torque constants, friction and torque sensors from links' telemetry: the command `drives`."""

import argparse

from fss_arm_calib.bag_options import EPILOG, add_settings, outputs
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_ros.command_line import Parser


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser("drives", description=__doc__, epilog=EPILOG)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags: one session")
    outputs(p, "calibrated description")
    add_settings(p, DrivesSettings)
    return p
