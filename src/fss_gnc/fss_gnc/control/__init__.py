"""Control of the base: a wrench that holds or leads it, and the valves that give the wrench."""

from .allocation import Allocation as Allocation
from .pose import PoseControl as PoseControl
from .pose import PoseGains as PoseGains
