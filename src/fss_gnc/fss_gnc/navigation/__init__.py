"""Estimation of the pose and twist of base and target from measurements.

Only `messages` depends on ROS.
"""

from .body_filter import BodyFilter, BodyState
from .inputs import KnownInputs
from .navigation import Navigation
from .settings import EstimatorSettings, SensorErrors

__all__ = [
    "BodyFilter",
    "BodyState",
    "EstimatorSettings",
    "KnownInputs",
    "Navigation",
    "SensorErrors",
]
