"""Kinematic calibration: lengths, joint offsets and the arm's mount."""
