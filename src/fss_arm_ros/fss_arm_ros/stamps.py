"""When the stamps of a stream go back for good: a replay begins again, a clock is set back."""

from fss_arm_ros.convert import SECOND

SAMPLES = 10  # in a row that are behind before the newest one is believed


class Stamps:
    """The stamps of one stream; a few that are out of order, or one far ahead, are no step back."""

    def __init__(self) -> None:
        self.newest = -1
        self.behind = 0

    def set_back(self, t: int) -> bool:
        """Take a stamp [ns]; whether SAMPLES in a row are more than 1 s behind by now."""
        if t > self.newest - SECOND:
            self.newest, self.behind = max(self.newest, t), 0
            return False
        self.behind += 1
        return self.behind >= SAMPLES
