"""Detection of stamps that jump back: a replay restarts, a clock is set back."""

from fss_arm_model.units import SECOND

MIN_SAMPLES = 10  # consecutive old samples that prove a jump


class Stamps:
    """Stamps of one stream; some out of order, or one far ahead, are not a jump back."""

    def __init__(self) -> None:
        self.newest = -1
        self.behind = 0

    def set_back(self, t: int) -> bool:
        """Add a stamp [ns]; return True if MIN_SAMPLES in a row are over 1 s behind the newest."""
        if t > self.newest - SECOND:
            self.newest, self.behind = max(self.newest, t), 0
            return False
        self.behind += 1
        return self.behind >= MIN_SAMPLES
