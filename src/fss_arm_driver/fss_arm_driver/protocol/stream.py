"""Frames on a byte stream, as RS-232 or TCP: where one begins is found again after any noise.

Consistent overhead byte stuffing (Cheshire and Baker 1999): a zero byte stands before and after
each frame and nowhere within, as each zero of the frame is replaced by the distance to the next.
"""

from fss_arm_driver.protocol.envelope import FRAME_SIZE

_STUFFED = FRAME_SIZE + 1  # a frame is shorter than 254 bytes, so stuffing adds one byte to it


def pack(frame: bytes) -> bytes:
    """A frame of 72 bytes as 75 bytes of a stream."""
    stuffed = b"".join(bytes([len(run) + 1]) + run for run in frame.split(b"\0"))
    return b"\0" + stuffed + b"\0"


class StreamDecoder:
    """Finds the frames in a stream that is fed in pieces of any size.

    `received` counts the bytes fed, `frames` the frames found. Not more than a frame is kept.
    """

    def __init__(self) -> None:
        self.received = self.frames = 0
        self._rest = b""  # since the last zero

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that end in `data`; what is none is skipped."""
        self.received += len(data)
        *chunks, rest = (self._rest + data).split(b"\0")
        self._rest = rest[: _STUFFED + 1]  # one byte too long is enough to be none
        found = [frame for chunk in chunks if (frame := _unstuff(chunk))]
        self.frames += len(found)
        return found


def _unstuff(chunk: bytes) -> bytes:
    """The frame that was stuffed into `chunk`, or nothing."""
    if len(chunk) != _STUFFED:
        return b""
    runs, at = [], 0
    while at < _STUFFED:
        runs.append(chunk[at + 1 : at + chunk[at]])
        at += chunk[at]
    return b"\0".join(runs) if at == _STUFFED else b""
