"""The links' wire protocol, version 2 (docs/reference/protocol.md): bytes in, bytes out."""

from fss_arm_driver.protocol.frames import (
    ACCELERATION_UNIT,
    CURRENT_UNIT,
    FRAME_SIZE,
    LAST,
    NO_TORQUE,
    VELOCITY_UNIT,
    Command,
    Frame,
    FrameError,
    Mode,
    Order,
    Refusal,
    Segment,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
    newer,
)
from fss_arm_driver.protocol.gate import Gate, Refused
from fss_arm_driver.protocol.path import hermite
from fss_arm_driver.protocol.signature import KeyFileError, load_keys, parse_keys
from fss_arm_driver.protocol.state import Goal, LinkState
from fss_arm_driver.protocol.stream import StreamDecoder, pack

__all__ = [
    "ACCELERATION_UNIT",
    "CURRENT_UNIT",
    "FRAME_SIZE",
    "LAST",
    "NO_TORQUE",
    "VELOCITY_UNIT",
    "Command",
    "Frame",
    "FrameError",
    "Gate",
    "Goal",
    "KeyFileError",
    "LinkState",
    "Mode",
    "Order",
    "Refusal",
    "Refused",
    "Segment",
    "Slow",
    "State",
    "StreamDecoder",
    "Telemetry",
    "decode",
    "encode",
    "hermite",
    "load_keys",
    "newer",
    "pack",
    "parse_keys",
]
