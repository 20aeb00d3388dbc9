"""What all frames share: their beginning, their CRC and signature, and how damage is refused.

A `Codec` is a set of kinds of frames, each a dataclass and the layout of its own 32 bytes.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import Enum
from operator import attrgetter
from typing import Any, Generic, Protocol, TypeVar
from zlib import crc32

from fss_arm_driver.protocol.signature import SIGNATURE_SIZE, is_signed, sign

FRAME_SIZE = 72  # the Wi-Fi shields drop longer datagrams
MAGIC = 0x4653
VERSION = 2

_HEAD = "<HBBBBHIQ"  # magic, version, kind, link, flags, boot, sequence, clock
_CRC = struct.Struct("<I")
_KIND = struct.Struct("<HBB")  # magic, version, kind
_SIGNATURE_AT = FRAME_SIZE - SIGNATURE_SIZE
_CRC_AT = _SIGNATURE_AT - _CRC.size


def unsigned(bits: int) -> Any:
    """A field of a frame."""
    return field(metadata={"range": (0, (1 << bits) - 1)})


def signed(bits: int) -> Any:
    """A field of a frame, two's complement."""
    return field(metadata={"range": (-(1 << bits - 1), (1 << bits - 1) - 1)})


class Refusal(Enum):
    """Why bytes are not a frame, in the order of the checks."""

    LENGTH = "length"
    MAGIC = "magic"
    VERSION = "version"
    KIND = "kind"
    CRC = "crc"
    SIGNATURE = "signature"
    FIELD = "field"


class FrameError(ValueError):
    """These bytes are not a frame, or these values do not make one; `reason` says why."""

    def __init__(self, reason: Refusal, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Head(Protocol):
    """What every frame begins with."""

    @property
    def link(self) -> int:
        """Number of the link; 0: the base's board."""

    @property
    def flags(self) -> int:
        """One bit each."""

    @property
    def boot(self) -> int:
        """Tells the starts of the electronics apart."""

    @property
    def sequence(self) -> int:
        """Counts the sender's frames, modulo 2^32."""

    @property
    def clock(self) -> int:
        """The sender's [us]."""


class Heard(Head, Protocol):
    """What all telemetry has; of its flags, 1 is armed, 2 stopped, 4 watchdog."""

    @property
    def echo(self) -> int:
        """Low 32 bits of the `clock` of the last command taken; 0: none yet."""

    @property
    def turnaround(self) -> int:
        """From that command's arrival to the measurement [us]."""

    @property
    def slow_id(self) -> int:
        """Which of the slow fields the frame has."""

    @property
    def slow_value(self) -> int:
        """What that is."""


class Ordered(Head, Protocol):
    """What all commands have; of their flags, 1 is arm, 2 stop."""

    @property
    def expiry(self) -> int:
        """In the receiver's clock [us]; 0: none."""

    @property
    def watchdog(self) -> int:
        """Silence after which the receiver disarms itself [ms]."""


F = TypeVar("F")


@dataclass(frozen=True)
class Kind(Generic[F]):
    """One kind of frame.

    Args:
        number: in the frame.
        frame: its dataclass, whose fields stand in the frame's order.
        body: layout of its own 32 bytes, as struct has it; what is skipped there must be 0.
        check: raises FrameError if values that fit their fields make no sense.
        values: of the body, if they are not those of the fields.
        restore: the fields from these, then.
    """

    number: int
    frame: type[F]
    body: str
    check: Callable[[F], None]
    values: Callable[[F], tuple[Any, ...]] | None = None
    restore: Callable[..., tuple[Any, ...]] | None = None


def invalid(what: str) -> FrameError:
    """That a field has no meaning."""
    return FrameError(Refusal.FIELD, what)


class _Coder(Generic[F]):
    """Packs and unpacks one kind, CRC and signature excepted."""

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
    """Frames of some kinds to bytes and back; all other kinds are refused."""

    def __init__(self, *kinds: Kind[Any]) -> None:
        self._coders = {kind.number: _Coder(kind) for kind in kinds}
        self._by_type = {kind.frame: self._coders[kind.number] for kind in kinds}

    def encode(self, frame: F, key: bytes | None = None) -> bytes:
        """The 72 bytes of `frame`, or FrameError."""
        body = self._by_type[type(frame)].pack(frame)
        data = body + _CRC.pack(crc32(body))
        return data + sign(data, key)

    def decode(self, data: bytes, key: bytes | None = None) -> F:
        """The frame that these bytes are, or FrameError."""
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
    """Raise FrameError if a flag has no meaning."""
    if frame.flags & ~known:
        raise invalid(f"flags are {frame.flags:#x}, expected only {known:#x}")


def newer(sequence: int, than: int) -> bool:
    """Whether `sequence` comes after `than`, modulo 2^32 (RFC 1982)."""
    return 0 < (sequence - than) & 0xFFFFFFFF < 0x80000000


def spoken(data: bytes) -> tuple[int, int]:
    """Version and link of a frame of whatever version: 72 bytes that begin with the magic."""
    return data[2], data[4]
