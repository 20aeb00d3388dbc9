"""Random numbers of the sensors; each depends only on the seed, a stream and a counter."""

from enum import IntEnum

import numpy as np

from fss_arm_model.arrays import Floats

BLOCK = 256  # number of frames whose random numbers are drawn together


class Stream(IntEnum):
    """Purpose of random numbers; a new purpose takes a new stream, so that no other changes."""

    FRAME, REST, RUN, CHANCE, WALK, TARGET, MARKER, DISTORTION, MERGE, JITTER = range(10)


class RandomNumbers:
    """Random numbers of each frame: `width` normal and `width` uniform ones."""

    def __init__(self, seed: int, width: int, stream: Stream = Stream.FRAME) -> None:
        self._seed, self._width, self._stream = seed, width, stream
        self._block = -1
        self._normal = self._uniform = np.empty((0, 0))

    def normal(self, frame: int) -> Floats:
        """Return normal numbers of mean 0 and standard deviation 1, (width,)."""
        self._draw(frame // BLOCK)
        row: Floats = self._normal[frame % BLOCK]
        return row

    def uniform(self, frame: int) -> list[float]:
        """Return uniform numbers from 0 to 1, (width,)."""
        self._draw(frame // BLOCK)
        row: list[float] = self._uniform[frame % BLOCK].tolist()
        return row

    def _draw(self, block: int) -> None:
        if block != self._block:
            size = BLOCK, self._width
            self._block = block
            self._normal = random_generator(self._seed, self._stream, block).standard_normal(size)
            which = () if self._stream is Stream.FRAME else (int(self._stream),)
            self._uniform = random_generator(self._seed, Stream.CHANCE, block, *which).random(size)


def random_generator(seed: int, stream: Stream, *counters: int) -> np.random.Generator:
    """Return the random generator of a seed and a stream for one or more counters."""
    return np.random.default_rng((seed, int(stream), *counters))
