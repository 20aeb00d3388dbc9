"""Hold of the base after a stall: this process did not run for a while, as on a busy computer.

Meanwhile the valves close, the base drifts and the reference moves on. To chase the reference
afterwards would be a motion without a plan. So it is dropped, its source is asked to end its
goal, and the base is held where it is found. References are followed again after one without
points, which ends the old one, or after a while without any.
"""

from dataclasses import dataclass

from fss_arm_model.arrays import Floats
from fss_gnc.reference import Body, Reference


@dataclass
class StallHold:
    """State of the hold: none, until `start`."""

    max_pause: float  # between two checks, above which it is a stall [s]
    timeout: float  # time without references after which their source has ended [s]
    reason: str = ""  # why references are dropped; empty: they are followed
    pose: Floats | None = None  # pose that is held, (3,); None: the valves stay closed
    last_check: float | None = None  # [s]
    silence: float = 0.0  # time since the last reference [s]
    is_commanded: bool = False  # True if a reference was dropped since the stall

    @property
    def is_asking(self) -> bool:
        """True if the source of the references must end its goal."""
        return bool(self.reason) and self.is_commanded

    def check(self, time: float) -> float:
        """Return the length of a stall that has just ended, else 0.

        Args:
            time: of a clock that is never set and that runs while the computer sleeps [s].
        """
        last, self.last_check = self.last_check, time
        pause = 0.0 if last is None else time - last
        return pause if pause > self.max_pause else 0.0

    def start(self, pause: float) -> None:
        """Drop references from now on, after a stall of a length [s]."""
        self.reason = f"control paused for {pause:.1f} s"
        self.pose, self.silence, self.is_commanded = None, 0.0, False

    def accepts(self, has_points: bool) -> bool:
        """Return True if a received reference counts; one without points ends the hold."""
        if self.reason and has_points:
            self.silence, self.is_commanded = 0.0, True
            return False
        self.reason = ""
        return True

    def wait(self, period: float) -> None:
        """Let a control period pass [s]; a long time without references ends the hold."""
        self.silence += period
        if self.silence > self.timeout:
            self.reason = ""

    def reference(self, base: Body) -> Reference | None:
        """Return the reference that holds the base; None without a source that wants it moved.

        Args:
            base: its state, measured after the stall.
        """
        if not self.is_commanded:
            return None
        if self.pose is None:
            self.pose = base.pose
        return Reference.at_rest(self.pose)
