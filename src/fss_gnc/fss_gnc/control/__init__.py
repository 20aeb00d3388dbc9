"""Control of the base: a wrench that holds or leads it."""

from .pose import PoseControl as PoseControl
from .pose import PoseGains as PoseGains
