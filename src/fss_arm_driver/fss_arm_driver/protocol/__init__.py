"""The links' wire protocol, version 1 (docs/reference/protocol.md): bytes in, bytes out."""

from fss_arm_driver.protocol.frames import (
    ACCELERATION_UNIT,
    CURRENT_UNIT,
    FRAME_SIZE,
    NO_TORQUE,
    VELOCITY_UNIT,
    Command,
    FrameError,
    Mode,
    Order,
    Refusal,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
    newer,
)
from fss_arm_driver.protocol.gate import Gate, Refused
from fss_arm_driver.protocol.signature import KeyFileError, load_keys, parse_keys
from fss_arm_driver.protocol.state import Goal, LinkState
from fss_arm_driver.protocol.stream import StreamDecoder, pack

__all__ = [
    "ACCELERATION_UNIT",
    "CURRENT_UNIT",
    "FRAME_SIZE",
    "NO_TORQUE",
    "VELOCITY_UNIT",
    "Command",
    "FrameError",
    "Gate",
    "Goal",
    "KeyFileError",
    "LinkState",
    "Mode",
    "Order",
    "Refusal",
    "Refused",
    "Slow",
    "State",
    "StreamDecoder",
    "Telemetry",
    "decode",
    "encode",
    "load_keys",
    "newer",
    "pack",
    "parse_keys",
]
