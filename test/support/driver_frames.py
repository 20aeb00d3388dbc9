"""Frames of a link, and damaged ones that look sound."""

import struct
from dataclasses import replace
from hashlib import blake2s
from itertools import pairwise
from zlib import crc32

from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    State,
    Telemetry,
)

BOOT, SECOND = 7, 1_000_000
KEY = bytes(range(16))
SAMPLE = Telemetry(
    link=2, flags=State.ARMED | State.REFERENCED, boot=3, sequence=1000, clock=200_000_000,
    echo=0x89ABCDEF, turnaround=1500, position=-40000, velocity=-12345, current=-75,
    mode=Mode.POSITION, slow_id=Slow.SUPPLY, status=0x08000000, torque=-2, torque_age=12,
    slow_value=240,
)  # fmt: skip
ORDER = Command(
    link=2, flags=LinkCommandFlag.ARM, boot=3, sequence=77, clock=1_700_000_000_000_000,
    expiry=201_000_000, mode=Mode.POSITION, watchdog=2000, set_point=40000, velocity=381972,
    acceleration=7639,
)  # fmt: skip
PIECE = Segment(
    link=2, flags=LAST_SEGMENT, boot=3, sequence=78, clock=1_700_000_000_000_001, path=7, index=4,
    begin=202_000_000, duration=2_500_000, position=40000, velocity=38197, end_position=-12000,
    end_velocity=0,
)  # fmt: skip


DISARM = Command(
    link=2, flags=0, boot=BOOT, sequence=1, clock=5, expiry=0, mode=Mode.OFF, watchdog=2000,
    set_point=0, velocity=0, acceleration=0,
)  # fmt: skip
MOVE = replace(
    DISARM,
    flags=LinkCommandFlag.ARM,
    sequence=2,
    expiry=100 * SECOND,
    mode=Mode.POSITION,
    set_point=200_000,
    velocity=381_972,
    acceleration=7639,
)


def path_segments(knots, **fields):
    """Return the segments of a path from its knots: time [us], counts and 0.1 counts/s."""
    pairs = list(pairwise(knots))
    return [
        replace(
            PIECE, flags=LAST_SEGMENT * (k == len(pairs) - 1), index=k, begin=t0, duration=t1 - t0,
            position=p0, velocity=v0, end_position=p1, end_velocity=v1, **fields,
        )
        for k, ((t0, p0, v0), (t1, p1, v1)) in enumerate(pairs)
    ]  # fmt: skip


def with_crc(data: bytes) -> bytes:
    """A frame with its CRC put right."""
    return data[:52] + struct.pack("<I", crc32(data[:52])) + data[56:]


def sealed(data: bytes, key: bytes | None) -> bytes:
    """A frame with CRC and signature put right."""
    data = with_crc(data)[:56]
    return data + (blake2s(data, digest_size=16, key=key).digest() if key else bytes(16))
