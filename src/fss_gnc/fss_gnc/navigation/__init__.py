"""Where the base is and how it moves, from what its sensors measure. No ROS but in `messages`."""

from .base_filter import BaseFilter, BaseState
from .inputs import KnownInputs
from .settings import SensorErrors

__all__ = ["BaseFilter", "BaseState", "KnownInputs", "SensorErrors"]
