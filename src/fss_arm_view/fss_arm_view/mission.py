"""Mission and planned path of a vehicle, for as long as their messages are recent."""

from collections.abc import Iterable
from math import isfinite

from fss_arm_model.units import SECOND

MISSION_TIMEOUT = 2 * SECOND  # time for which a message is valid [ns]

Point = tuple[float, float]  # x, y [m]


class Mission:
    """State of a mission; times t are stamps of the vehicle's newest measurement [ns]."""

    def __init__(self) -> None:
        self.text = ""  # mission, phase and reason
        self._keep_out = 0.0  # radius of the zone about the target [m]; 0: none
        self._path: list[Point] = []
        # Times at which a mission, its path, and any path were received [ns].
        self._received = self._mission_path_received = self._path_received = -MISSION_TIMEOUT

    def receive(self, t: int, keep_out: float, path: Iterable[Point]) -> bool:
        """Store a mission's keep-out radius and path; return True if it has a path."""
        self._received = t
        self._keep_out = keep_out if isfinite(keep_out) else 0.0
        points = list(path)
        if points:
            self._mission_path_received = t
            self._set_path(t, points)
        return bool(points)

    def receive_base_path(self, t: int, path: Iterable[Point]) -> bool:
        """Store the base's planned path; return False if the mission has its own recent path."""
        if t <= self._mission_path_received + MISSION_TIMEOUT:
            return False
        self._set_path(t, path)
        return True

    def _set_path(self, t: int, path: Iterable[Point]) -> None:
        self._path = [(x, y) for x, y in path if isfinite(x) and isfinite(y)]
        self._path_received = t

    def is_over(self, t: int) -> bool:
        """Return True if the mission has not been published recently."""
        return t > self._received + MISSION_TIMEOUT

    def path(self, t: int) -> list[Point]:
        """Return the planned positions of the base, unless they are old."""
        return self._path if t < self._path_received + MISSION_TIMEOUT else []

    def keep_out(self, t: int) -> float:
        """Return the keep-out radius about the target [m]; 0: none, or it is old."""
        return self._keep_out if t < self._received + MISSION_TIMEOUT else 0.0
