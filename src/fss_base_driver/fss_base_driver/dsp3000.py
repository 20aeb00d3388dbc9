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
RATE = 100.0  # rate of lines, within 3 % [Hz]
MAX_RATE = 375.0  # measurement range [deg/s]
MAX_LINE_LENGTH = 64  # length from which bytes without an end of line are noise [bytes]
_LINE = re.compile(rb"\s*(-?\d{1,3}\.\d{6})\s+([01])\s*")


class Counts(NamedTuple):
    """Counters of the received lines."""

    rates: int = 0
    faults: int = 0  # the gyro reports an invalid rate
    noise: int = 0  # malformed or endless lines, or impossible rates


class Lines:
    """Decoder of a byte stream that is fed in pieces of any size.

    Lines have no checksum. A truncated line or a flipped bit is detected only by the line's form
    and by the size of the rate. Everything before the first end of line is dropped, because it may
    be the rest of a line.
    """

    def __init__(self) -> None:
        self.counts = Counts()
        self.reset()

    def reset(self) -> None:
        """Reset the decoder after the port was opened or flushed; the counters are kept."""
        self._rest, self._skips = b"", True  # bytes of the present line, and whether it is dropped

    def feed(self, data: bytes) -> list[float | None]:
        """Return the rates of the lines that end in `data`, in order [rad/s].

        None: the line is invalid.
        """
        *ended, rest = (self._rest + data).split(b"\n")
        if ended and self._skips:
            del ended[0]
            self._skips = False
        if len(rest) > MAX_LINE_LENGTH:
            rest, self._skips = b"", True
            self._count(noise=1)
        self._rest = rest
        return [self._rate(line) for line in ended]

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
