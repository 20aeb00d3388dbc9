"""Control of the base: a wrench that holds it or makes it follow a path."""

from .pose import PoseControl as PoseControl
from .pose import PoseGains as PoseGains
