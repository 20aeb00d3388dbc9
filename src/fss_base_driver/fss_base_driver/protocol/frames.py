"""Encoding and decoding of the telemetry and command frames of the base's board.

Values are raw counts and units of the wire. The caller converts the gyro's counts into SI units
with the gyro's scale.
"""

from dataclasses import dataclass
from enum import IntEnum

from fss_link.protocol import Codec, Kind, check_command, check_flags, invalid, signed, unsigned

BOARD = 0  # number of the board, in the field for a link
VALVES = 8
TIME_UNIT = 100  # unit of on-times and of a pulse's age [us]
MAX_ON_TIME = 0xFFFF  # largest on-time [TIME_UNIT]
MAX_PULSE_AGE = 0xFFFF  # age of a pulse that is this old or older
NO_ON_TIMES = (0,) * VALVES


class BaseState(IntEnum):
    """Flags of a telemetry frame, one bit each."""

    ARMED = 1
    STOPPED = 2  # latched until a command frame with neither arm nor stop
    WATCHDOG = 4  # commands stopped; the board disarmed for that reason
    LIMITED = 8  # a limit closed a valve early
    SPENT = 16  # the valves' total time is used up


class BaseCommandFlag(IntEnum):
    """Flags of a command frame, one bit each."""

    ARM = 1  # absent: disarm
    STOP = 2  # disarm and latch it


class Gripper(IntEnum):
    """Command to the gripper."""

    KEEP = 0
    OPEN = 1
    CLOSE = 2


class GripperFlag(IntEnum):
    """State of the gripper in telemetry, one bit each."""

    COMMANDED_CLOSED = 1
    CLOSED = 2
    HOLDS = 4


class BaseSlow(IntEnum):
    """Fields that change slowly and take turns in `BaseTelemetry.slow_value`."""

    TANK = 1
    SUPPLY = 2
    BATTERY = 3
    TEMPERATURE = 4
    FIRMWARE = 5
    REFUSED = 6
    FAULTS = 7
    LEFT = 8
    OPEN_1 = 9
    OPEN_2 = 10
    OPEN_3 = 11
    OPEN_4 = 12
    OPEN_5 = 13
    OPEN_6 = 14
    OPEN_7 = 15
    OPEN_8 = 16


@dataclass(frozen=True, slots=True)
class BaseTelemetry:
    """Telemetry frame of the board."""

    link: int = unsigned(8)  # BOARD
    flags: int = unsigned(8)  # BaseState
    boot: int = unsigned(16)  # differs between starts of the board: 1 or more
    sequence: int = unsigned(32)  # counts the frames since the start, modulo 2^32
    clock: int = unsigned(64)  # the board's own clock at the measurement [us since its start]
    echo: int = unsigned(32)  # low 32 bits of the `clock` of the last accepted command; 0: none yet
    turnaround: int = unsigned(32)  # from that command's arrival to the measurement [us]
    gyro_sum: int = unsigned(32)  # of all samples since the start, modulo 2^32 [counts]
    gyro_samples: int = unsigned(16)  # number of these samples, modulo 2^16
    valves: int = unsigned(8)  # bit i: valve i + 1 is open
    gripper: int = unsigned(8)  # GripperFlag
    pulse: int = unsigned(16)  # number of the last started pulse; 0: none since the board started
    pulse_age: int = unsigned(16)  # time since that pulse started [TIME_UNIT], or MAX_PULSE_AGE
    slow_id: int = unsigned(8)  # BaseSlow
    slow_value: int = signed(32)  # of the field `slow_id`


@dataclass(frozen=True, slots=True)
class BaseCommand:
    """Command to the board, valid until `expiry` or the next command."""

    link: int = unsigned(8)  # BOARD
    flags: int = unsigned(8)  # BaseCommandFlag
    boot: int = unsigned(16)  # of the addressed board; 0: not known yet, never with ARM
    sequence: int = unsigned(32)  # counts the frames of one host session, modulo 2^32
    clock: int = unsigned(64)  # the host's stamp, echoed by the board [us]
    expiry: int = unsigned(64)  # in the board's clock [us]; 0: none, never with ARM
    pulse: int = unsigned(16)  # its number; 0: all valves close
    watchdog: int = unsigned(16)  # silence after which the board disarms itself [ms], 1 or more
    on_times: tuple[int, ...] = NO_ON_TIMES  # of the valves, from the pulse's start [TIME_UNIT]
    gripper: int = Gripper.KEEP


BaseFrame = BaseTelemetry | BaseCommand


def _check_head(frame: BaseFrame, flags: int) -> None:
    if frame.link != BOARD:
        raise invalid(f"link is {frame.link}, expected {BOARD}")
    check_flags(frame, flags)


def _check_telemetry(frame: BaseTelemetry) -> None:
    _check_head(frame, sum(BaseState))
    if frame.boot == 0:
        raise invalid("boot is 0, expected 1 or more")
    if frame.gripper > sum(GripperFlag):
        raise invalid(f"gripper is {frame.gripper}, expected 0 to {sum(GripperFlag)}")
    if frame.slow_id not in _SLOW_IDS:
        raise invalid(f"slow_id is {frame.slow_id}, expected 1 to {max(_SLOW_IDS)}")


def _check_command(frame: BaseCommand) -> None:
    _check_head(frame, sum(BaseCommandFlag))
    check_command(frame)
    times = frame.on_times
    if len(times) != VALVES or not all(0 <= time <= MAX_ON_TIME for time in times):
        raise invalid(f"on_times are {times}, expected {VALVES} from 0 to {MAX_ON_TIME}")
    if frame.gripper not in _GRIPPER:
        raise invalid(f"gripper is {frame.gripper}, expected 0 to {max(_GRIPPER)}")
    if any(times) and not frame.pulse:
        raise invalid("on_times without a pulse")
    if not frame.flags & BaseCommandFlag.ARM and (frame.pulse or frame.gripper):
        raise invalid("a pulse or a gripper command without arm")


_SLOW_IDS = frozenset(BaseSlow)
_GRIPPER = frozenset(Gripper)
_CODEC: Codec[BaseFrame] = Codec(
    Kind(4, BaseTelemetry, "IIIHBBHHB3xi4x", _check_telemetry),
    Kind(
        5,
        BaseCommand,
        "QHH8HB3x",
        _check_command,
        lambda c: (c.expiry, c.pulse, c.watchdog, *c.on_times, c.gripper),
        lambda expiry, pulse, watchdog, *rest: (expiry, pulse, watchdog, rest[:-1], rest[-1]),
    ),
)


def encode(frame: BaseFrame, key: bytes | None = None) -> bytes:
    """Return the 72 bytes of `frame`, signed if a key is given.

    Raises:
        FrameError: a value does not fit its field or its meaning; the message names it.
    """
    return _CODEC.encode(frame, key)


def decode(data: bytes, key: bytes | None = None) -> BaseFrame:
    """Return the frame in these bytes; it must be signed under the key, or unsigned without one.

    Raises:
        FrameError: the bytes are no valid frame; no other exception is raised for any bytes.
    """
    return _CODEC.decode(data, key)
