"""Decoder of a KVH DSP-3000 fibre-optic gyro on a serial port: lines of text to rates.

This is for the unit with the 100 Hz asynchronous interface (technical manual 54-0215 Rev. C,
chapter 2): RS-232, 38400 baud, 8N1, about 100 lines a second. A line is (-)xxx.xxxxxx, a space, and
1 for valid or 0 for a fault. In its default mode the number is the rate in degrees per second,
averaged since the last line.
"""

import re
from math import radians
from typing import NamedTuple

BAUD = 38_400
RATE = 100.0  # lines a second, within 3 %
MAX_RATE = 375.0  # measurement range [deg/s]
MAX_LINE_LENGTH = 64  # most bytes before an end of line [bytes]
_LINE = re.compile(rb"\s*(-?\d{1,3}\.\d{6})\s+([01])\s*")


class Counts(NamedTuple):
    """Counters of the received lines."""

    rates: int = 0
    faults: int = 0  # the gyro reports an invalid rate
    noise: int = 0  # malformed lines, or impossible rates


class Lines:
    """Decoder of a byte stream that is fed in pieces of any size.

    Lines have no checksum. A truncated line or a flipped bit is detected only by the line's form
    and by the size of the rate. Everything before the first end of line is dropped, because it may
    be the rest of a line.
    """

    def __init__(self) -> None:
        self.counts = Counts()
        self._rest: bytes | None = None  # None: skip to the next end of line

    def reset(self) -> None:
        """Reset the decoder after the port was opened again; the counters are kept."""
        self._rest = None

    def feed(self, data: bytes) -> list[float]:
        """Return the rates whose lines end in `data`, in order [rad/s]."""
        first, *ended = data.split(b"\n")
        if not ended:
            if self._rest is not None:
                self._rest += data
                if len(self._rest) > MAX_LINE_LENGTH:
                    self._rest = None
                    self._count(noise=1)
            return []
        lines = [] if self._rest is None else [self._rest + first]
        *whole, self._rest = ended
        found = [self._rate(line) for line in [*lines, *whole]]
        return [rate for rate in found if rate is not None]

    def _rate(self, line: bytes) -> float | None:
        """Return the rate of a line [rad/s]; None if the line is invalid."""
        match = _LINE.fullmatch(line)
        if match is None or abs(degrees := float(match[1])) > MAX_RATE:
            self._count(noise=1)
        elif match[2] == b"0":
            self._count(faults=1)
        else:
            self._count(rates=1)
            return radians(degrees)
        return None

    def _count(self, rates: int = 0, faults: int = 0, noise: int = 0) -> None:
        old = self.counts
        self.counts = Counts(old.rates + rates, old.faults + faults, old.noise + noise)
