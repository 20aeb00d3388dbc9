"""Scene of one vehicle: stored measurements, drawn with each new pose of the base."""

from collections import deque
from collections.abc import Sequence
from math import dist, inf, nan

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.thrusters import THRUSTER_COUNT
from fss_arm_model.units import SECOND

from . import scene
from .mission import Mission, Point
from .scene import Drawing

MIN_PLUME_DURATION = 0.2  # for which a thruster pulse is drawn [s]
MAX_PREDICTION_AGE = 3 * SECOND  # of a predicted base that is drawn [ns]
TRAIL_COLORS = {
    "tip_path": scene.TIP_COLOR,
    "com_path": scene.PREDICTED_COLOR,
    "base_path": scene.MEASURED_COLOR,
}
Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]


class VehicleScene:
    """Scene of one vehicle; times t are stamps [ns].

    Args:
        arm: its present description.
        name: label beside its base; empty: no label.
    """

    def __init__(self, arm: Arm, name: str = "") -> None:
        self.arm, self.name = arm, name
        self.q = [0.0] * arm.n  # joint angles [rad]
        self.reset()

    def reset(self) -> None:
        """Discard all measurements except the joint angles."""
        self.mission = Mission()
        self.plumes_until = [0] * THRUSTER_COUNT  # [ns]
        self.pose: Pose | None = None  # of the base
        self.tip: Pose | None = None
        self.target: Pose | None = None
        self.difference: Floats | None = None  # measured minus predicted base [m, m, rad]
        self.sigma = nan  # of the predicted heading [rad]
        self._difference_valid_until = 0
        self.trails: dict[str, deque[Point]] = {
            what: deque(maxlen=scene.MAX_TRAIL_POINTS) for what in TRAIL_COLORS
        }

    def fire(self, t: int, on_times: Sequence[float]) -> None:
        """Set the times until which the plumes of the thrusters are drawn; on_times in [s]."""
        if not all(0.0 <= seconds < inf for seconds in on_times):
            return  # the board rejects the command
        shortest = t + int(MIN_PLUME_DURATION * SECOND)
        for k, seconds in enumerate(on_times):
            if seconds > 0.0:
                self.plumes_until[k] = max(t + int(seconds * SECOND), shortest)
            else:  # the plume of a pulse that has just ended is still drawn
                self.plumes_until[k] = min(self.plumes_until[k], shortest)

    def store_prediction_error(
        self, t: int, difference: Sequence[float], sigma: float = nan
    ) -> None:
        """Store how far the measured base is from the predicted one.

        Args:
            t: stamp [ns].
            difference: (3,) measured minus predicted pose [m, m, rad]; NaN: no prediction.
            sigma: standard deviation of the predicted heading [rad].
        """
        self.sigma = sigma
        self.difference = np.array(difference) if np.isfinite(difference).all() else None
        self._difference_valid_until = t + MAX_PREDICTION_AGE

    def recent_difference(self, t: int) -> Floats | None:
        """Return the base's pose, measured minus predicted, (3,); None: no recent prediction."""
        return self.difference if t < self._difference_valid_until else None

    def draw_base(self, t: int, pose: Pose) -> list[Drawing]:
        """Draw the base, the whole arm, the planned path and the base's trail."""
        plumes = scene.plumes(pose, [t < until for until in self.plumes_until])
        parts = [plumes, *scene.arm(self.arm, pose, self.q)]
        # A prediction is older than this pose: draw it relative to the pose.
        if (difference := self.recent_difference(t)) is not None:
            parts.append(scene.base(pose - difference, scene.PREDICTED_COLOR))
        parts.append(scene.base(pose, scene.MEASURED_COLOR))
        if path := self.mission.path(t):
            parts.append(scene.route([pose[:2], *path]))
        named = [scene.name_label(pose, self.name)] if self.name else []
        drawings = [scene.combine("arm", parts), scene.base_transform(pose), *named]
        return [*drawings, *self.extend_trail("base_path", pose[:2])]

    def draw_target(self, t: int, pose: Pose) -> list[Drawing]:
        """Draw the target, and the circle to keep out of."""
        parts = [scene.base(pose, scene.TARGET_COLOR)]
        if (radius := self.mission.keep_out(t)) > 0.0:
            parts.append(scene.circle(pose[:2], radius, scene.TARGET_COLOR))
        return [scene.combine("target", parts)]

    def extend_trail(self, what: str, point: Point) -> list[Drawing]:
        """Extend a trail and draw it, if the point has moved."""
        trail = self.trails[what]
        if trail and dist(trail[-1], point) <= scene.MIN_TRAIL_STEP:
            return []
        trail.append(point)
        return [scene.trail(trail, what, TRAIL_COLORS[what])]


class FrameLoss:
    """Share of a link's telemetry frames that were lost, as a moving average."""

    def __init__(self) -> None:
        self.share = 0.0
        self._sequence: int | None = None  # number of the last frame

    def add(self, sequence: int) -> float:
        """Add a received frame; return the share of lost frames."""
        missed = 0 if self._sequence is None else sequence - self._sequence - 1
        lost = missed / (missed + 1) if missed >= 0 else 0.0
        self.share = 0.95 * self.share + 0.05 * lost
        self._sequence = sequence
        return self.share
