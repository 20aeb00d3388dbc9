"""Telemetry, command and segment frames to bytes and back.

The layout and what both sides do with it are in docs/reference/protocol.md. Raw counts only:
whoever holds the arm's description turns them into SI units.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import Enum, IntEnum
from typing import Any
from zlib import crc32

from fss_arm_driver.protocol.signature import SIGNATURE_SIZE, is_signed, sign

FRAME_SIZE = 72  # the Wi-Fi shields drop longer datagrams
NO_TORQUE = 255  # as the age of a torque sample: that old or older, or there is none [ms]
MAGIC = 0x4653
VERSION = 2

VELOCITY_UNIT = 0.1  # [counts/s]
ACCELERATION_UNIT = 10.0  # [counts/s^2]
CURRENT_UNIT = 0.01  # [A]

LAST = 1  # flag of a segment: the path ends with it
MAX_PATH = 0xFFFF  # number of a path
MAX_INDEX = 0xFFFE  # of a segment
DURATIONS = 1000, 60_000_000  # of a segment [us]


def _unsigned(bits: int) -> Any:
    return field(metadata={"range": (0, (1 << bits) - 1)})


def _signed(bits: int) -> Any:
    return field(metadata={"range": (-(1 << bits - 1), (1 << bits - 1) - 1)})


class Mode(IntEnum):
    """What the servo drive controls, by the drive's own numbers; PATH only in commands."""

    OFF = 0
    CURRENT = 1
    VELOCITY = 11
    POSITION = 21
    PATH = 31  # the drive is in VELOCITY meanwhile


class State(IntEnum):
    """Flags of a telemetry frame, one bit each."""

    ARMED = 1
    STOPPED = 2  # latched until a command frame with neither arm nor stop
    WATCHDOG = 4  # commands ceased; disarmed for that reason
    REFERENCED = 8  # the encoder's zero is known
    FOLLOWING = 16  # a path moves the joint
    BROKEN = 32  # the last path ended before its last knot


class Order(IntEnum):
    """Flags of a command frame, one bit each."""

    ARM = 1  # absent: disarm
    STOP = 2  # disarm and latch it
    HOLD = 4  # decelerate and hold where the joint comes to rest
    CLEAR_FAULTS = 8
    HOME = 16  # find the reference as the drive is set up to; only with ARM, position mode


class Slow(IntEnum):
    """Fields that change slowly and take turns in `Telemetry.slow_value`."""

    FAULTS = 1
    SUPPLY = 2
    BATTERY = 3
    TEMPERATURE = 4
    FIRMWARE = 5
    HOMINGS = 6
    REFUSED = 7
    PATH = 8  # newest path held * 65536 + its segments without a gap from the first


@dataclass(frozen=True, slots=True)
class Telemetry:
    """What a link reports: one measurement, in the servo drive's and torque converter's counts."""

    link: int = _unsigned(8)  # 1 beside the base
    flags: int = _unsigned(8)  # State
    boot: int = _unsigned(16)  # counts the starts of the link's electronics, from 1
    sequence: int = _unsigned(32)  # counts the frames since the start, modulo 2^32
    clock: int = _unsigned(64)  # the link's own clock at the measurement [us since its start]
    echo: int = _unsigned(32)  # low 32 bits of the `clock` of the last command taken; 0: none yet
    turnaround: int = _unsigned(32)  # from that command's arrival to the measurement [us]
    position: int = _signed(32)  # [counts]
    velocity: int = _signed(32)  # [0.1 counts/s]
    current: int = _signed(16)  # [0.01 A]
    mode: int = _unsigned(8)  # Mode
    slow_id: int = _unsigned(8)  # Slow
    status: int = _unsigned(32)  # the servo drive's status word
    torque: int = _signed(24)  # 24 bits, two's complement [counts]
    torque_age: int = _unsigned(8)  # of the torque sample at the measurement [ms], or NO_TORQUE
    slow_value: int = _signed(32)  # of the field `slow_id`


@dataclass(frozen=True, slots=True)
class Command:
    """What a link shall do until `expiry` or the next command."""

    link: int = _unsigned(8)
    flags: int = _unsigned(8)  # Order
    boot: int = _unsigned(16)  # of the link that is meant; 0: not known yet, never with ARM
    sequence: int = _unsigned(32)  # counts the frames of one host session, modulo 2^32
    clock: int = _unsigned(64)  # the host's stamp, echoed by the link [us]
    expiry: int = _unsigned(64)  # in the link's clock [us]; 0: none, never with ARM
    mode: int = _unsigned(8)  # Mode
    watchdog: int = _unsigned(16)  # silence after which the link disarms itself [ms], 1 or more
    set_point: int = _signed(32)  # [0.01 A], [0.1 counts/s], [counts] or a path's number, by mode
    velocity: int = _signed(32)  # of the profile, or a path's most [0.1 counts/s]
    acceleration: int = _signed(32)  # of the profile, or a path's most [10 counts/s^2]


@dataclass(frozen=True, slots=True)
class Segment:
    """The piece of a path between two of its knots: the cubic through both (Hermite's)."""

    link: int = _unsigned(8)
    flags: int = _unsigned(8)  # LAST
    boot: int = _unsigned(16)  # of the link that is meant
    sequence: int = _unsigned(32)  # counts the frames of one host session, modulo 2^32
    clock: int = _unsigned(64)  # the host's stamp [us]
    path: int = _unsigned(16)  # its number, 1 or more
    index: int = _unsigned(16)  # of the segment in the path, from 0
    begin: int = _unsigned(64)  # by the link's clock [us]
    duration: int = _unsigned(32)  # [us]
    position: int = _signed(32)  # at the beginning [counts]
    velocity: int = _signed(32)  # at the beginning [0.1 counts/s]
    end_position: int = _signed(32)
    end_velocity: int = _signed(32)  # 0 with LAST

    @property
    def end(self) -> int:
        """By the link's clock [us]."""
        return self.begin + self.duration


Frame = Telemetry | Command | Segment


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


_TELEMETRY, _COMMAND, _SEGMENT = 1, 2, 3
_KINDS = {Telemetry: _TELEMETRY, Command: _COMMAND, Segment: _SEGMENT}
_HEAD = "<HBBBBHIQ"  # magic, version, kind, link, flags, boot, sequence, clock
_TELEMETRY_BODY = struct.Struct(_HEAD + "IIiihBBIIi")  # torque and its age share one word
_TELEMETRY_FIELDS = struct.Struct("<4xBBHIQIIiihBBIIi")  # the same from the link on
_COMMAND_BODY = struct.Struct(_HEAD + "QBBHiii8s")
_SEGMENT_BODY = struct.Struct(_HEAD + "HHQIiiii")
_CRC = struct.Struct("<I")
_KIND = struct.Struct("<HBB")  # magic, version, kind
_SIGNATURE_AT = FRAME_SIZE - SIGNATURE_SIZE
_CRC_AT = _SIGNATURE_AT - _CRC.size
_RESERVED = bytes(8)

_MODES = {_TELEMETRY: frozenset(Mode) - {Mode.PATH}, _COMMAND: frozenset(Mode)}
_FLAGS = {_TELEMETRY: sum(State), _COMMAND: sum(Order), _SEGMENT: LAST}
_SLOW_IDS = frozenset(Slow)


def newer(sequence: int, than: int) -> bool:
    """Whether `sequence` comes after `than`, modulo 2^32 (RFC 1982)."""
    return 0 < (sequence - than) & 0xFFFFFFFF < 0x80000000


def spoken(data: bytes) -> tuple[int, int]:
    """Version and link of a frame of whatever version: 72 bytes that begin with the magic."""
    return data[2], data[4]


def encode(frame: Frame, key: bytes | None = None) -> bytes:
    """The 72 bytes of `frame`, signed if a key is given.

    Raises:
        FrameError: a value does not fit its field or its meaning; the message names it.
    """
    _check_ranges(frame)
    _check_meaning(frame)
    head = MAGIC, VERSION, _KINDS[type(frame)], *_common(frame)
    if isinstance(frame, Telemetry):
        body = _pack_telemetry(head, frame)
    elif isinstance(frame, Command):
        body = _pack_command(head, frame)
    else:
        body = _pack_segment(head, frame)
    data = body + _CRC.pack(crc32(body))
    return data + sign(data, key)


def decode(data: bytes, key: bytes | None = None) -> Frame:
    """The frame that these bytes are, signed under the key; not signed at all without one.

    Raises:
        FrameError: they are none; nothing else is ever raised, whatever the bytes.
    """
    if len(data) != FRAME_SIZE:
        raise FrameError(Refusal.LENGTH, f"{len(data)} bytes, expected {FRAME_SIZE}")
    magic, version, kind = _KIND.unpack_from(data)
    if magic != MAGIC:
        raise FrameError(Refusal.MAGIC, f"magic is {magic:#06x}, expected {MAGIC:#06x}")
    if version != VERSION:
        raise FrameError(Refusal.VERSION, f"version is {version}, expected {VERSION}")
    if kind not in _READERS:
        raise FrameError(Refusal.KIND, f"kind is {kind}, expected one of {list(_READERS)}")
    (crc,) = _CRC.unpack_from(data, _CRC_AT)
    if crc != crc32(data[:_CRC_AT]):
        raise FrameError(Refusal.CRC, f"CRC is {crc:#010x}, which does not fit the bytes")
    if not is_signed(data[:_SIGNATURE_AT], data[_SIGNATURE_AT:], key):
        expected = "that of the key" if key else "zero, as no key is configured"
        raise FrameError(Refusal.SIGNATURE, f"signature is not {expected}")
    frame = _READERS[kind](data)
    _check_meaning(frame)
    return frame


def _common(frame: Frame) -> tuple[int, ...]:
    return frame.link, frame.flags, frame.boot, frame.sequence, frame.clock


def _pack_telemetry(head: tuple[int, ...], frame: Telemetry) -> bytes:
    return _TELEMETRY_BODY.pack(
        *head, frame.echo, frame.turnaround, frame.position, frame.velocity, frame.current,
        frame.mode, frame.slow_id, frame.status, (frame.torque & 0xFFFFFF) | frame.torque_age << 24,
        frame.slow_value,
    )  # fmt: skip


def _telemetry(data: bytes) -> Telemetry:
    *values, word, slow_value = _TELEMETRY_FIELDS.unpack_from(data)
    torque = (word & 0xFFFFFF) - ((word & 0x800000) << 1)
    values += torque, word >> 24, slow_value
    return Telemetry(*values)


def _pack_command(head: tuple[int, ...], frame: Command) -> bytes:
    return _COMMAND_BODY.pack(
        *head, frame.expiry, frame.mode, 0, frame.watchdog, frame.set_point, frame.velocity,
        frame.acceleration, _RESERVED,
    )  # fmt: skip


def _command(data: bytes) -> Command:
    values = _COMMAND_BODY.unpack_from(data)[3:]
    if values[7] or values[-1] != _RESERVED:
        raise FrameError(Refusal.FIELD, "reserved bytes of a command are not zero")
    return Command(*values[:7], *values[8:-1])


def _pack_segment(head: tuple[int, ...], frame: Segment) -> bytes:
    return _SEGMENT_BODY.pack(
        *head, frame.path, frame.index, frame.begin, frame.duration, frame.position,
        frame.velocity, frame.end_position, frame.end_velocity,
    )  # fmt: skip


def _segment(data: bytes) -> Segment:
    return Segment(*_SEGMENT_BODY.unpack_from(data)[3:])


_READERS: dict[int, Callable[[bytes], Frame]] = {
    _TELEMETRY: _telemetry,
    _COMMAND: _command,
    _SEGMENT: _segment,
}


_RANGES = {
    kind: [(f.name, *f.metadata["range"]) for f in fields(kind)]
    for kind in (Telemetry, Command, Segment)
}


def _check_ranges(frame: Frame) -> None:
    for name, low, high in _RANGES[type(frame)]:
        if not low <= (value := getattr(frame, name)) <= high:
            raise FrameError(Refusal.FIELD, f"{name} is {value}, expected {low} to {high}")


def _check_meaning(frame: Frame) -> None:
    kind = _KINDS[type(frame)]
    if frame.link == 0:
        raise FrameError(Refusal.FIELD, "link is 0, expected 1 to 255")
    if frame.flags & ~_FLAGS[kind]:
        raise FrameError(
            Refusal.FIELD, f"flags are {frame.flags:#x}, expected only {_FLAGS[kind]:#x}"
        )
    if isinstance(frame, Segment):
        _check_segment(frame)
        return
    if frame.mode not in _MODES[kind]:
        expected = sorted(map(int, _MODES[kind]))
        raise FrameError(Refusal.FIELD, f"mode is {frame.mode}, expected one of {expected}")
    if isinstance(frame, Telemetry):
        _check_telemetry(frame)
    else:
        _check_command(frame)


def _check_telemetry(frame: Telemetry) -> None:
    if frame.boot == 0:
        raise FrameError(Refusal.FIELD, "boot is 0, expected 1 or more")
    if frame.slow_id not in _SLOW_IDS:
        raise FrameError(
            Refusal.FIELD, f"slow_id is {frame.slow_id}, expected 1 to {max(_SLOW_IDS)}"
        )


def _check_segment(frame: Segment) -> None:
    if frame.boot == 0 or frame.path == 0:
        raise FrameError(Refusal.FIELD, "boot or path of a segment is 0, expected 1 or more")
    if frame.index > MAX_INDEX:
        raise FrameError(Refusal.FIELD, f"index is {frame.index}, expected 0 to {MAX_INDEX}")
    low, high = DURATIONS
    if not low <= frame.duration <= high:
        raise FrameError(
            Refusal.FIELD, f"duration is {frame.duration} us, expected {low} to {high}"
        )
    if frame.flags & LAST and frame.end_velocity:
        raise FrameError(
            Refusal.FIELD, f"end_velocity is {frame.end_velocity} in a last segment, expected 0"
        )
    if frame.end >= 1 << 64:
        raise FrameError(Refusal.FIELD, f"end is {frame.end} us, beyond 64 bits")


def _check_command(frame: Command) -> None:
    if frame.watchdog == 0:
        raise FrameError(Refusal.FIELD, "watchdog is 0 ms, expected 1 or more")
    if frame.velocity < 0 or frame.acceleration < 0:
        raise FrameError(
            Refusal.FIELD,
            f"profile is {frame.velocity}, {frame.acceleration}, expected none negative",
        )
    if frame.mode == Mode.PATH and not 1 <= frame.set_point <= MAX_PATH:
        raise FrameError(Refusal.FIELD, f"path is {frame.set_point}, expected 1 to {MAX_PATH}")
    if frame.flags & Order.HOME and not frame.flags & Order.ARM:
        raise FrameError(Refusal.FIELD, "flags hold home without arm")
    if not frame.flags & Order.ARM:
        return
    if frame.flags & Order.STOP:
        raise FrameError(Refusal.FIELD, "flags hold both arm and stop")
    if frame.boot == 0:
        raise FrameError(Refusal.FIELD, "boot is 0 in a command that arms")
    if frame.expiry == 0:
        raise FrameError(Refusal.FIELD, "expiry is 0 in a command that arms")
