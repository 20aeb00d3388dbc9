"""Where base and target are and how they move, from what is measured of them.

No ROS but in `messages`.
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
