"""Messages that are published or heard often, written into and read from their bytes.

To make and serialize a message takes many times as long as to hand it over, and so does the way
back.
"""

from struct import Struct, pack_into
from typing import Any, NamedTuple

from rclpy.serialization import serialize_message

from fss_arm_ros.convert import SECOND

ENCAPSULATION = STAMP = 4  # bytes before the message, from which on numbers are aligned
DOUBLE = 8  # bytes
#: The encapsulation's kind and options, the stamp, and the length of the frame id that follows.
HEADER = Struct("<HHiII")
LITTLE = 0x0100  # the kind 0001, in this order


class SerializedMessage:
    """A serialized message (CDR, little-endian) that begins with a stamp and ends with doubles.

    Args:
        message: without numbers in it.
        doubles: how many it ends with.
        stamp: where the stamp is [bytes].
    """

    def __init__(self, message: Any, doubles: int, stamp: int = STAMP) -> None:
        data = serialize_message(message)
        if data[:2] != b"\0\1":
            raise NotImplementedError(f"CDR of kind {data[:2].hex()}, expected 0001")
        self._data, self._doubles = bytearray(data), len(data) - DOUBLE * doubles
        self._stamp = stamp

    def stamped(self, stamp: int) -> None:
        """Put the stamp [ns] in place."""
        pack_into("<iI", self._data, self._stamp, *divmod(stamp, SECOND))

    def put(self, first: int, *values: float) -> None:
        """Put doubles in place, from the `first` on."""
        pack_into(f"<{len(values)}d", self._data, self._doubles + DOUBLE * first, *values)

    def bytes(self) -> bytes:
        """What to publish."""
        return bytes(self._data)


class Numbers(NamedTuple):
    """What a message says that is a header and doubles."""

    stamp: int  # [ns]
    values: tuple[float, ...]


class NumbersReader:
    """Reads serialized messages (CDR, little-endian) that are a header and doubles.

    Args:
        doubles: how many.
    """

    def __init__(self, doubles: int) -> None:
        self._doubles = Struct(f"<{doubles}d")

    def read(self, data: bytes) -> Numbers | None:
        """What a message says; None: it has another byte order or length, or no proper stamp."""
        if len(data) < HEADER.size:
            return None
        kind, _, sec, nanosec, length = HEADER.unpack_from(data)
        first = ENCAPSULATION + -(-(HEADER.size - ENCAPSULATION + length) // DOUBLE) * DOUBLE
        if kind != LITTLE or len(data) != first + self._doubles.size:
            return None
        if sec < 0 or nanosec >= SECOND:
            return None
        return Numbers(sec * SECOND + nanosec, self._doubles.unpack_from(data, first))
