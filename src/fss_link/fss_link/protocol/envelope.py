"""Common parts of all frames: header, CRC and signature, and the rejection of damaged frames.

A `Codec` is a set of kinds of frames. Each kind has a dataclass and the layout of its own 32 bytes.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import Enum, IntEnum
from operator import attrgetter
from typing import Any, Generic, Protocol, TypeVar
from zlib import crc32

from fss_link.protocol.signature import SIGNATURE_SIZE, is_signed, sign

FRAME_SIZE = 72  # the Wi-Fi shields drop longer datagrams
MAGIC = 0x4653
VERSION = 2

_HEAD = "<HBBBBHIQ"  # magic, version, kind, link, flags, boot, sequence, clock
_CRC = struct.Struct("<I")
_KIND = struct.Struct("<HBB")  # magic, version, kind
_SIGNATURE_AT = FRAME_SIZE - SIGNATURE_SIZE
_CRC_AT = _SIGNATURE_AT - _CRC.size


def unsigned(bits: int) -> Any:
    """Define an unsigned field of a frame."""
    return field(metadata={"range": (0, (1 << bits) - 1)})


def signed(bits: int) -> Any:
    """Define a signed field of a frame, two's complement."""
    return field(metadata={"range": (-(1 << bits - 1), (1 << bits - 1) - 1)})


class StatusFlag(IntEnum):
    """Flags that telemetry of all electronics has; each kind may have more."""

    ARMED = 1
    STOPPED = 2  # latched until a command frame with neither arm nor stop
    WATCHDOG = 4  # disarmed because no commands came


class CommandFlag(IntEnum):
    """Flags of commands; electronics without faults do not use CLEAR_FAULTS."""

    ARM = 1  # absent: disarm
    STOP = 2  # disarm and latch it
    CLEAR_FAULTS = 8


class Refusal(Enum):
    """Reason why bytes are not a valid frame, in the order of the checks."""

    LENGTH = "length"
    MAGIC = "magic"
    VERSION = "version"
    KIND = "kind"
    CRC = "crc"
    SIGNATURE = "signature"
    FIELD = "field"


class FrameError(ValueError):
    """Error of bytes or values that are not a valid frame; `reason` says why."""

    def __init__(self, reason: Refusal, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Head(Protocol):
    """Header of every frame."""

    @property
    def link(self) -> int:
        """Number of the link; 0: the base's board."""

    @property
    def flags(self) -> int:
        """Flags, one bit each."""

    @property
    def boot(self) -> int:
        """Number that differs between starts of the electronics."""

    @property
    def sequence(self) -> int:
        """Count of the sender's frames, modulo 2^32."""

    @property
    def clock(self) -> int:
        """Clock of the sender [us]."""


class TelemetryHead(Head, Protocol):
    """Common fields of all telemetry; its flags include StatusFlag."""

    @property
    def echo(self) -> int:
        """Low 32 bits of the `clock` of the last accepted command; 0: none yet."""

    @property
    def turnaround(self) -> int:
        """Time from that command's arrival to the measurement [us]."""

    @property
    def slow_id(self) -> int:
        """Number of the slow field that the frame has."""

    @property
    def slow_value(self) -> int:
        """Value of that slow field."""


class CommandHead(Head, Protocol):
    """Common fields of all commands; their flags include CommandFlag."""

    @property
    def expiry(self) -> int:
        """Expiry in the receiver's clock [us]; 0: none."""

    @property
    def watchdog(self) -> int:
        """Silence after which the receiver disarms itself [ms]."""


F = TypeVar("F")


@dataclass(frozen=True)
class Kind(Generic[F]):
    """Kind of frame.

    Args:
        number: of the kind, as in the frame.
        frame: its dataclass, with the fields in the frame's order.
        body: layout of its own 32 bytes, in the notation of struct; padding must be 0.
        check: raises FrameError if values that fit their fields are not valid.
        values: returns the values of the body, if they differ from those of the fields.
        restore: returns the fields from these values.
    """

    number: int
    frame: type[F]
    body: str
    check: Callable[[F], None]
    values: Callable[[F], tuple[Any, ...]] | None = None
    restore: Callable[..., tuple[Any, ...]] | None = None


def invalid(what: str) -> FrameError:
    """Return a FrameError about an invalid field."""
    return FrameError(Refusal.FIELD, what)


class _Coder(Generic[F]):
    """Coder of one kind of frame, without CRC and signature."""

    def __init__(self, kind: Kind[F]) -> None:
        self.number, self._frame, self._check = kind.number, kind.frame, kind.check
        self._layout = struct.Struct(_HEAD + kind.body)
        names = [f.name for f in fields(kind.frame)]  # type: ignore[arg-type]
        self._values = kind.values or attrgetter(*names[5:])
        self._head: Callable[[F], tuple[int, ...]] = attrgetter(*names[:5])
        self._restore = kind.restore
        self._ranges = [
            (f.name, *f.metadata["range"])
            for f in fields(kind.frame)  # type: ignore[arg-type]
            if f.metadata
        ]

    def pack(self, frame: F) -> bytes:
        for name, low, high in self._ranges:
            if not low <= (value := getattr(frame, name)) <= high:
                raise invalid(f"{name} is {value}, expected {low} to {high}")
        self._check(frame)
        head, body = self._head(frame), self._values(frame)
        return self._layout.pack(MAGIC, VERSION, self.number, *head, *body)

    def unpack(self, data: bytes) -> F:
        values = self._layout.unpack_from(data)
        if self._layout.pack(*values) != data[:_CRC_AT]:
            raise invalid("reserved bytes are not zero")
        body = values[8:]
        frame = self._frame(*values[3:8], *(self._restore(*body) if self._restore else body))
        self._check(frame)
        return frame


class Codec(Generic[F]):
    """Conversion of some kinds of frames to bytes and back; other kinds are rejected."""

    def __init__(self, *kinds: Kind[Any]) -> None:
        self._coders = {kind.number: _Coder(kind) for kind in kinds}
        self._by_type = {kind.frame: self._coders[kind.number] for kind in kinds}

    def encode(self, frame: F, key: bytes | None = None) -> bytes:
        """Encode `frame` as 72 bytes, or raise FrameError."""
        body = self._by_type[type(frame)].pack(frame)
        data = body + _CRC.pack(crc32(body))
        return data + sign(data, key)

    def decode(self, data: bytes, key: bytes | None = None) -> F:
        """Decode a frame, or raise FrameError."""
        if len(data) != FRAME_SIZE:
            raise FrameError(Refusal.LENGTH, f"{len(data)} bytes, expected {FRAME_SIZE}")
        magic, version, kind = _KIND.unpack_from(data)
        if magic != MAGIC:
            raise FrameError(Refusal.MAGIC, f"magic is {magic:#06x}, expected {MAGIC:#06x}")
        if version != VERSION:
            raise FrameError(Refusal.VERSION, f"version is {version}, expected {VERSION}")
        if kind not in self._coders:
            known = list(self._coders)
            raise FrameError(Refusal.KIND, f"kind is {kind}, expected one of {known}")
        (crc,) = _CRC.unpack_from(data, _CRC_AT)
        if crc != crc32(data[:_CRC_AT]):
            raise FrameError(Refusal.CRC, f"CRC is {crc:#010x}, which does not fit the bytes")
        if not is_signed(data[:_SIGNATURE_AT], data[_SIGNATURE_AT:], key):
            expected = "that of the key" if key else "zero, as no key is configured"
            raise FrameError(Refusal.SIGNATURE, f"signature is not {expected}")
        frame: F = self._coders[kind].unpack(data)
        return frame


def check_flags(frame: Head, known: int) -> None:
    """Raise FrameError if an unknown flag is set."""
    if frame.flags & ~known:
        raise invalid(f"flags are {frame.flags:#x}, expected only {known:#x}")


def check_command(frame: CommandHead) -> None:
    """Raise FrameError if a common field of commands is not valid."""
    if frame.watchdog == 0:
        raise invalid("watchdog is 0 ms, expected 1 or more")
    if not frame.flags & CommandFlag.ARM:
        return
    if frame.flags & CommandFlag.STOP:
        raise invalid("flags contain both arm and stop")
    if frame.boot == 0:
        raise invalid("boot is 0 in a command that arms")
    if frame.expiry == 0:
        raise invalid("expiry is 0 in a command that arms")


def newer(sequence: int, than: int) -> bool:
    """Return True if `sequence` is later than `than`, modulo 2^32 (RFC 1982)."""
    return 0 < (sequence - than) & 0xFFFFFFFF < 0x80000000


def version_and_link(data: bytes) -> tuple[int, int]:
    """Return version and link of a frame of any version: 72 bytes that start with the magic."""
    return data[2], data[4]
