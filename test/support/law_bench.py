"""Inputs of a law, with a number of its own in each place."""

import numpy as np

from fss_gnc.law import Inputs


def inputs(joints=4, **changes):
    values = {
        "joints": joints,
        "time": 1.5,
        "period": 0.02,
        "base_pose": np.array([0.1, -0.05, 3.2]),
        "base_twist": np.array([0.01, -0.02, 0.03]),
        "base_covariance": 1e-6 * np.arange(36.0),
        "base_age": 0.004,
        "joint_angles": 0.1 * np.arange(1.0, joints + 1.0),
        "joint_rates": 0.01 * np.arange(1.0, joints + 1.0),
        "reference_pose": np.array([0.2, 0.1, -3.0]),
        "reference_twist": np.array([0.001, 0.002, 0.003]),
        "reference_acceleration": np.array([0.004, 0.005, 0.006]),
        "valves_armed": True,
        "joints_armed": np.arange(joints) % 2 == 0,
        "valves_stuck_open": np.arange(8) == 2,
        "valves_stuck_closed": np.arange(8) == 5,
        "propellant": 0.07,
    }
    return Inputs(**(values | changes))
