"""Calibration of the arm's parameters, live and from bags."""

__version__ = "0.2.0"
