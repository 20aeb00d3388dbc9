"""When the stamps of a stream go back for good: a replay begins again, a clock is set back."""

SECOND = 1_000_000_000  # [ns]
LOST = 10  # samples in a row after which the newest one is believed


class Stamps:
    """The stamps of one stream; a few that are out of order, or one far ahead, are no step back."""

    def __init__(self) -> None:
        self.newest = -1
        self.late = 0

    def set_back(self, t: int) -> bool:
        """Take a stamp [ns]; whether as many as LOST in a row are more than 1 s back by now."""
        if t > self.newest - SECOND:
            self.newest, self.late = max(self.newest, t), 0
            return False
        self.late += 1
        return self.late >= LOST
