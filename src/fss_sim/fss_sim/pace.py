"""When frames are due."""

from collections.abc import Callable

from fss_sim.testbed import FRAME


class Pace:
    """Frames at their rate by some clock [ns]; a late frame is made up for and never skipped.

    Args:
        now: reads the clock.
        frame: the last one made.
        back: a clock that is further behind the last frame was set, not late [ns].
        ahead: likewise, ahead of it; the pace then goes on from the new time.
    """

    def __init__(self, now: Callable[[], int], frame: int, back: int, ahead: int) -> None:
        self.now, self.back, self.ahead = now, back, ahead
        self.epoch = now() - frame * FRAME  # the clock's time of frame 0
        self.jumps = 0

    def late(self, frame: int) -> int:
        """Time since the frame, by the clock [ns]; from FRAME on, the next one is due."""
        late = self.now() - self.epoch - frame * FRAME
        if -self.back <= late <= self.ahead:
            return late
        self.epoch += late
        self.jumps += 1
        return 0
