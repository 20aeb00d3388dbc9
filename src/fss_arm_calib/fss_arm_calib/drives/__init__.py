"""Calibration of drives: torque constant, friction, torque sensor, rotor."""
