"""Drift calibration: tilt, hose torque and drag."""
