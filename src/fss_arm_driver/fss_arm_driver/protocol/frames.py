"""Conversion of telemetry, command and segment frames to bytes and back.

docs/reference/protocol.md defines the layout and how both sides use it. Values are raw counts;
`Scale` converts them to SI units with the arm's description.
"""

from dataclasses import dataclass
from enum import IntEnum

from fss_link.protocol.envelope import (
    Codec,
    Kind,
    check_command,
    check_flags,
    invalid,
    signed,
    unsigned,
)

NO_TORQUE = 255  # `torque_age` of a sample that is 255 ms old or older, or missing

VELOCITY_UNIT = 0.1  # [counts/s]
ACCELERATION_UNIT = 10.0  # [counts/s^2]
CURRENT_UNIT = 0.01  # [A]

LAST_SEGMENT = 1  # flag of a segment: the path ends with it
MAX_PATH = 0xFFFF  # number of a path
MAX_INDEX = 0xFFFE  # of a segment; the number of segments fits 16 bits
DURATIONS = 1000, 60_000_000  # of a segment [us]


class Mode(IntEnum):
    """Control mode of the servo drive, by the drive's own numbers; PATH only in commands."""

    OFF = 0
    CURRENT = 1
    VELOCITY = 11
    POSITION = 21
    PATH = 31  # the drive then is in VELOCITY mode


class State(IntEnum):
    """Flags of a telemetry frame, one bit each."""

    ARMED = 1
    STOPPED = 2  # latched until a command frame with neither arm nor stop
    WATCHDOG = 4  # disarmed because no commands came
    REFERENCED = 8  # the encoder's zero is known
    FOLLOWING = 16  # a path moves the joint
    BROKEN = 32  # the last path was aborted before its last knot


class LinkCommandFlag(IntEnum):
    """Flags of a command frame, one bit each."""

    ARM = 1  # absent: disarm
    STOP = 2  # disarm and latch it
    HOLD = 4  # decelerate and hold where the joint comes to rest
    CLEAR_FAULTS = 8
    HOME = 16  # home as the drive is configured to; only with ARM


class Slow(IntEnum):
    """Slowly changing fields, sent in turn as `Telemetry.slow_value`."""

    FAULTS = 1  # the drive's fault word
    SUPPLY = 2  # voltage of the drive [0.1 V]
    BATTERY = 3  # voltage [0.1 V]
    TEMPERATURE = 4  # of the drive [deg C]
    FIRMWARE = 5  # its version
    HOMINGS = 6  # how often the drive was homed since the start
    REFUSED = 7  # number of refused datagrams
    PATH = 8  # newest path held * 65536 + number of its segments up to the first gap
    SERIAL = 9  # of the physical link; 0: it has none


@dataclass(frozen=True, slots=True)
class Telemetry:
    """Measurement of a link, in the servo drive's and torque converter's counts."""

    link: int = unsigned(8)  # 1 next to the base
    flags: int = unsigned(8)  # State
    boot: int = unsigned(16)  # differs between starts of the link's electronics: 1 or more
    sequence: int = unsigned(32)  # counts the frames since the start, modulo 2^32
    clock: int = unsigned(64)  # the link's own clock at the measurement [us since its start]
    echo: int = unsigned(32)  # low 32 bits of the `clock` of the last accepted command; 0: none
    turnaround: int = unsigned(32)  # from that command's arrival to the measurement [us]
    position: int = signed(32)  # [counts]
    velocity: int = signed(32)  # [0.1 counts/s]
    current: int = signed(16)  # [0.01 A]
    mode: int = unsigned(8)  # Mode
    slow_id: int = unsigned(8)  # Slow
    status: int = unsigned(32)  # the servo drive's status word
    torque: int = signed(24)  # 24 bits, two's complement [counts]
    torque_age: int = unsigned(8)  # of the torque sample at the measurement [ms], or NO_TORQUE
    slow_value: int = signed(32)  # of the field `slow_id`


@dataclass(frozen=True, slots=True)
class Command:
    """Command for a link, valid until `expiry` or the next command."""

    link: int = unsigned(8)
    flags: int = unsigned(8)  # LinkCommandFlag
    boot: int = unsigned(16)  # of the addressed link; 0: not known yet, never with ARM
    sequence: int = unsigned(32)  # counts the frames of one host session, modulo 2^32
    clock: int = unsigned(64)  # the host's stamp, echoed by the link [us]
    expiry: int = unsigned(64)  # in the link's clock [us]; 0: none, never with ARM
    mode: int = unsigned(8)  # Mode
    watchdog: int = unsigned(16)  # silence after which the link disarms itself [ms], 1 or more
    set_point: int = signed(32)  # [0.01 A], [0.1 counts/s], [counts] or a path's number, by mode
    velocity: int = signed(32)  # of the profile, or a path's limit [0.1 counts/s]
    acceleration: int = signed(32)  # of the profile, or a path's limit [10 counts/s^2]


@dataclass(frozen=True, slots=True)
class Segment:
    """Segment of a path between two knots: a cubic Hermite polynomial."""

    link: int = unsigned(8)
    flags: int = unsigned(8)  # LAST_SEGMENT
    boot: int = unsigned(16)  # of the addressed link
    sequence: int = unsigned(32)  # counts the frames of one host session, modulo 2^32
    clock: int = unsigned(64)  # the host's stamp [us]
    path: int = unsigned(16)  # its number, 1 or more
    index: int = unsigned(16)  # of the segment in the path, from 0
    begin: int = unsigned(64)  # start, in the link's clock [us]
    duration: int = unsigned(32)  # [us]
    position: int = signed(32)  # at the start [counts]
    velocity: int = signed(32)  # at the start [0.1 counts/s]
    end_position: int = signed(32)  # [counts]
    end_velocity: int = signed(32)  # 0 with LAST_SEGMENT [0.1 counts/s]

    @property
    def end(self) -> int:
        """End in the link's clock [us]."""
        return self.begin + self.duration


Frame = Telemetry | Command | Segment


_TELEMETRY_MODES, _COMMAND_MODES = frozenset(Mode) - {Mode.PATH}, frozenset(Mode)
_SLOW_IDS = frozenset(Slow)


def _check_head(frame: Frame, flags: int) -> None:
    if frame.link == 0:
        raise invalid("link is 0, expected 1 to 255")
    check_flags(frame, flags)


def _check_mode(mode: int, known: frozenset[Mode]) -> None:
    if mode not in known:
        raise invalid(f"mode is {mode}, expected one of {sorted(map(int, known))}")


def _check_telemetry(frame: Telemetry) -> None:
    _check_head(frame, sum(State))
    _check_mode(frame.mode, _TELEMETRY_MODES)
    if frame.boot == 0:
        raise invalid("boot is 0, expected 1 or more")
    if frame.slow_id not in _SLOW_IDS:
        raise invalid(f"slow_id is {frame.slow_id}, expected 1 to {max(_SLOW_IDS)}")


def _check_segment(frame: Segment) -> None:
    _check_head(frame, LAST_SEGMENT)
    if frame.boot == 0 or frame.path == 0:
        raise invalid("boot or path of a segment is 0, expected 1 or more")
    if frame.index > MAX_INDEX:
        raise invalid(f"index is {frame.index}, expected 0 to {MAX_INDEX}")
    low, high = DURATIONS
    if not low <= frame.duration <= high:
        raise invalid(f"duration is {frame.duration} us, expected {low} to {high}")
    if frame.flags & LAST_SEGMENT and frame.end_velocity:
        raise invalid(f"end_velocity is {frame.end_velocity} in a last segment, expected 0")
    if frame.end >= 1 << 64:
        raise invalid(f"end is {frame.end} us, beyond 64 bits")


def _check_command(frame: Command) -> None:
    _check_head(frame, sum(LinkCommandFlag))
    _check_mode(frame.mode, _COMMAND_MODES)
    check_command(frame)
    if frame.velocity < 0 or frame.acceleration < 0:
        raise invalid(f"profile is {frame.velocity}, {frame.acceleration}, expected both 0 or more")
    if frame.mode == Mode.PATH and not 1 <= frame.set_point <= MAX_PATH:
        raise invalid(f"path is {frame.set_point}, expected 1 to {MAX_PATH}")
    if frame.flags & LinkCommandFlag.HOME and not frame.flags & LinkCommandFlag.ARM:
        raise invalid("flags contain home without arm")


def _telemetry_values(frame: Telemetry) -> tuple[int, ...]:
    """Return the values of the body, with the torque and its age in one word."""
    word = (frame.torque & 0xFFFFFF) | frame.torque_age << 24
    return (
        frame.echo,
        frame.turnaround,
        frame.position,
        frame.velocity,
        frame.current,
        frame.mode,
        frame.slow_id,
        frame.status,
        word,
        frame.slow_value,
    )


def _telemetry_fields(*values: int) -> tuple[int, ...]:
    *before, word, slow_value = values
    torque = (word & 0xFFFFFF) - ((word & 0x800000) << 1)  # extends the sign of 24 bits
    return *before, torque, word >> 24, slow_value


_CODEC: Codec[Frame] = Codec(
    Kind(1, Telemetry, "IIiihBBIIi", _check_telemetry, _telemetry_values, _telemetry_fields),
    Kind(2, Command, "QBxHiii8x", _check_command),
    Kind(3, Segment, "HHQIiiii", _check_segment),
)


def encode(frame: Frame, key: bytes | None = None) -> bytes:
    """Encode `frame` as 72 bytes, signed if a key is given.

    Raises:
        FrameError: a value does not fit its field or is not valid; the message names it.
    """
    return _CODEC.encode(frame, key)


def decode(data: bytes, key: bytes | None = None) -> Frame:
    """Decode a frame that is signed with the key; without a key, one that is not signed.

    Raises:
        FrameError: the bytes are not such a frame. No bytes raise any other error.
    """
    return _CODEC.decode(data, key)
