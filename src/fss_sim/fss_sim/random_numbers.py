"""Random numbers of the sensors: each a function of the seed, a stream and a counter alone."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

BLOCK = 256  # frames whose random numbers are drawn at once


class Stream(IntEnum):
    """What the numbers are for; a new use takes a new stream, so that the others stay."""

    FRAME, REST, RUN, CHANCE, WALK, TARGET, MARKER, DISTORTION, MERGE, JITTER = range(10)


class RandomNumbers:
    """Random numbers by frame, `width` of each kind: normal and uniform ones."""

    def __init__(self, seed: int, width: int, stream: Stream = Stream.FRAME) -> None:
        self._seed, self._width, self._stream = seed, width, stream
        self._block = -1
        self._normal = self._uniform = np.empty((0, 0))

    def normal(self, frame: int) -> npt.NDArray[np.float64]:
        """(width,) of mean 0 and deviation 1."""
        self._draw(frame // BLOCK)
        row: npt.NDArray[np.float64] = self._normal[frame % BLOCK]
        return row

    def uniform(self, frame: int) -> list[float]:
        """(width,) from 0 to 1."""
        self._draw(frame // BLOCK)
        row: list[float] = self._uniform[frame % BLOCK].tolist()
        return row

    def _draw(self, block: int) -> None:
        if block != self._block:
            size = BLOCK, self._width
            self._block = block
            self._normal = drawn(self._seed, self._stream, block).standard_normal(size)
            which = () if self._stream is Stream.FRAME else (int(self._stream),)
            self._uniform = drawn(self._seed, Stream.CHANCE, block, *which).random(size)


def drawn(seed: int, stream: Stream, *counters: int) -> np.random.Generator:
    """The generator of one counter's numbers, or of some counters'."""
    return np.random.default_rng((seed, int(stream), *counters))
