"""Frames on a byte stream (RS-232 or TCP); the decoder resynchronizes after noise.

Consistent overhead byte stuffing (Cheshire and Baker 1999): there is a zero byte before and after
each frame and none within it, because each zero of the frame is replaced by the distance to the
next.
"""

from fss_link.protocol.envelope import FRAME_SIZE

_STUFFED = FRAME_SIZE + 1  # a frame is shorter than 254 bytes, so stuffing adds one byte to it


def pack(frame: bytes) -> bytes:
    """Encode a frame of 72 bytes as 75 bytes of a stream."""
    stuffed = b"".join(bytes([len(run) + 1]) + run for run in frame.split(b"\0"))
    return b"\0" + stuffed + b"\0"


class StreamDecoder:
    """Decoder of a stream that is fed in pieces of any size.

    `received` counts the bytes fed, `frames` the frames found. At most about one frame is buffered.
    """

    def __init__(self) -> None:
        self.received = self.frames = 0
        self._rest = b""  # since the last zero

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that end in `data`; other bytes are skipped."""
        self.received += len(data)
        *chunks, rest = (self._rest + data).split(b"\0")
        self._rest = rest[: _STUFFED + 1]  # one byte too many is enough to be rejected
        found = [frame for chunk in chunks if (frame := _unstuff(chunk))]
        self.frames += len(found)
        return found


def _unstuff(chunk: bytes) -> bytes:
    """Return the frame that was stuffed into `chunk`, or empty bytes."""
    if len(chunk) != _STUFFED:
        return b""
    runs, at = [], 0
    while at < _STUFFED:
        runs.append(chunk[at + 1 : at + chunk[at]])
        at += chunk[at]
    return b"\0".join(runs) if at == _STUFFED else b""
