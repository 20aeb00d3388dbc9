"""ASCII language of Copley's servo drives: lines to the drive, and its answers.

One line at a time, ended by CR, without a checksum. The host sends first; after power-up at 9600
baud, 8N1. docs/start/hardware.md lists what is known of the language, and how reliably.
"""

from dataclasses import dataclass
from enum import IntEnum

FIRST_BAUD = 9600  # after power-up, a reset or a break
MAX_LENGTH = 64  # of a line; a longer one is noise


class Variable(IntEnum):
    """Variables of the drive that are used here, in RAM."""

    COMMANDED_CURRENT = 0x02  # [0.01 A]
    CURRENT = 0x0C  # [0.01 A]
    VELOCITY = 0x18  # [0.1 counts/s]
    SUPPLY = 0x1E  # [0.1 V]
    TEMPERATURE = 0x20  # [deg C]
    DESIRED_STATE = 0x24  # 0 off, 1 current, 11 velocity, 21 profile position
    COMMANDED_VELOCITY = 0x2F  # [0.1 counts/s]
    POSITION = 0x32  # [counts]
    ACCELERATION_LIMIT = 0x36  # of velocity mode [1000 counts/s^2]
    DECELERATION_LIMIT = 0x37
    BAUD = 0x90
    STATUS = 0xA0
    FAULTS = 0xA4  # latched; written to clear
    PROFILE_TYPE = 0xC8  # 0: absolute trapezoid
    TRAJECTORY_STATUS = 0xC9
    TARGET = 0xCA  # [counts]
    PROFILE_VELOCITY = 0xCB  # [0.1 counts/s]
    PROFILE_ACCELERATION = 0xCC  # [10 counts/s^2]
    PROFILE_DECELERATION = 0xCD
    ABORT_DECELERATION = 0xCF


class Trajectory(IntEnum):
    """Argument of the command `t`."""

    ABORT = 0
    START = 1  # or update a running move
    HOME = 2


REFERENCED, HOMING = 1 << 12, 1 << 13  # of the trajectory status
RESET = 1 << 20  # of the status

ERRORS = {
    1: "too much data",
    2: "checksum",
    3: "unknown command",
    4: "not enough data",
    5: "too much data",
    6: "flash memory not erased",
    7: "flash memory not written",
    8: "no such memory page",
    9: "unknown variable",
    10: "value out of range",
    11: "variable is read-only",
    12: "no such trace channel",
    13: "no such trace variable",
    14: "no such mode of operation",
    15: "variable is not on this page",
    16: "port cannot forward",
    17: "flash memory damaged",
    18: "already moving",
    19: "velocity limit",
    20: "acceleration limit",
    21: "deceleration limit",
    22: "jerk limit",
    25: "trajectory mode",
    27: "not while a program of the drive runs",
    31: "no such node to forward to",
    32: "CAN failure",
    33: "cannot read the line",
    34: "internal error",
    36: "no such axis",
    46: "encoder does not answer",
    48: "filter cannot be computed",
}


class LineError(ValueError):
    """Error of a line that is not a valid answer."""


@dataclass(frozen=True, slots=True)
class Ok:
    """Answer that the command was accepted; the joint need not move."""


@dataclass(frozen=True, slots=True)
class Value:
    """Answer with the value of a variable."""

    number: int


@dataclass(frozen=True, slots=True)
class Error:
    """Answer that the command was refused."""

    code: int

    def __str__(self) -> str:
        return f"error {self.code}: {ERRORS.get(self.code, 'not in the guide')}"


Reply = Ok | Value | Error


def get_variable(variable: Variable) -> bytes:
    """Encode the command that reads a variable."""
    return f"g r0x{variable:02x}\r".encode()


def set_variable(variable: Variable, number: int) -> bytes:
    """Encode the command that sets a variable."""
    return f"s r0x{variable:02x} {number}\r".encode()


def trajectory(action: Trajectory) -> bytes:
    """Encode the command to abort, start or home."""
    return f"t {action:d}\r".encode()


def parse(line: bytes) -> Reply:
    """Decode a line without its CR.

    Raises:
        LineError: the line is not a valid answer.
    """
    if line == b"ok":
        return Ok()
    kind, _, text = line.partition(b" ")
    digits = text.removeprefix(b"-")
    if kind in (b"v", b"e") and digits.isdigit() and len(digits) <= 10:
        number = int(text)
        if kind == b"v" and -(1 << 31) <= number < 1 << 32:
            return Value(number)
        if kind == b"e" and 0 <= number < 1000:
            return Error(number)
    raise LineError(f"the drive answered {line[:MAX_LENGTH]!r}")
