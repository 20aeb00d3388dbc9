"""Drivers of the base's hardware: the board's valves and gyro, and motion capture."""
