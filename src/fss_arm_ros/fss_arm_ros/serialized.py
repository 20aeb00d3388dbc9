"""Messages that are published often: serialized but once, then filled in.

To make and serialize a message takes many times as long as to hand it over.
"""

from struct import pack_into
from typing import Any

from rclpy.serialization import serialize_message

from fss_arm_ros.convert import SECOND

STAMP = 4  # where it is: after the encapsulation's header
DOUBLE = 8  # bytes


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
