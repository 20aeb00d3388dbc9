"""The frames of links and of the base's board: one table for both directions, damage refused."""

import random
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import base_board as base
import pytest
from driver_frames import KEY, ORDER, PIECE, SAMPLE, sealed, with_crc
from hypothesis import given
from hypothesis import strategies as st
from running import memory

from fss_arm_driver import protocol as links
from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    Telemetry,
)
from fss_base_driver import protocol as board
from fss_base_driver.protocol import BaseCommand, BaseCommandFlag, BaseSlow, BaseTelemetry
from fss_link.protocol import FRAME_SIZE, FrameError, Refusal, StreamDecoder, newer, pack

MAXIMAL_SEGMENT = Segment(
    link=255, flags=0, boot=0xFFFF, sequence=0xFFFFFFFF, clock=(1 << 64) - 1, path=0xFFFF,
    index=0xFFFE, begin=(1 << 64) - 60_000_001, duration=60_000_000, position=-(1 << 31),
    velocity=(1 << 31) - 1, end_position=(1 << 31) - 1, end_velocity=-(1 << 31),
)  # fmt: skip
FOLLOW = Command(
    link=2, flags=LinkCommandFlag.ARM, boot=3, sequence=79, clock=1_700_000_000_000_002,
    expiry=201_000_000, mode=Mode.PATH, watchdog=2000, set_point=0xFFFF, velocity=381972,
    acceleration=7639,
)  # fmt: skip
LIMITS = Telemetry(
    link=255, flags=63, boot=0xFFFF, sequence=0xFFFFFFFF, clock=(1 << 64) - 1, echo=0xFFFFFFFF,
    turnaround=0xFFFFFFFF, position=-(1 << 31), velocity=(1 << 31) - 1, current=-(1 << 15),
    mode=Mode.OFF, slow_id=Slow.PATH, status=0xFFFFFFFF, torque=-(1 << 23), torque_age=255,
    slow_value=-1,
)  # fmt: skip
DISARM = Command(
    link=1, flags=0, boot=0, sequence=0, clock=1, expiry=0, mode=Mode.OFF, watchdog=2000,
    set_point=0, velocity=0, acceleration=0,
)  # fmt: skip
BASE_LIMITS = BaseTelemetry(
    link=0, flags=31, boot=0xFFFF, sequence=0xFFFFFFFF, clock=(1 << 64) - 1, echo=0xFFFFFFFF,
    turnaround=0xFFFFFFFF, gyro_sum=0xFFFFFFFF, gyro_samples=0xFFFF, valves=255, gripper=7,
    pulse=0xFFFF, pulse_age=0xFFFF, slow_id=16, slow_value=-(1 << 31),
)  # fmt: skip

#: Frames without a signature; the board's without their CRC.
CASES = [
    (
        SAMPLE,
        "5346 02 01 02 09 0300 e8030000 00c2eb0b00000000 efcdab89 dc050000 c063ffff "
        "c7cfffff b5ff 15 02 00000008 feffff 0c f0000000 c6c8cbff",
    ),
    (
        ORDER,
        "5346 02 02 02 01 0300 4d000000 00401e18240a0600 4004fb0b00000000 15 00 d007 "
        "409c0000 14d40500 d71d0000 0000000000000000 3e9cc256",
    ),
    (
        FOLLOW,
        "5346 02 02 02 01 0300 4f000000 02401e18240a0600 4004fb0b00000000 1f 00 d007 "
        "ffff0000 14d40500 d71d0000 0000000000000000 32e9d2a9",
    ),
    (
        PIECE,
        "5346 02 03 02 01 0300 4e000000 01401e18240a0600 0700 0400 80460a0c00000000 "
        "a0252600 409c0000 35950000 20d1ffff 00000000 23671909",
    ),
    (
        MAXIMAL_SEGMENT,
        "5346 02 03 ff 00 ffff ffffffff ffffffffffffffff ffff feff "
        "ff786cfcffffffff 00879303 00000080 ffffff7f ffffff7f 00000080 69ac41f2",
    ),
    (
        LIMITS,
        "5346 02 01 ff 3f ffff ffffffff ffffffffffffffff ffffffff ffffffff 00000080 "
        "ffffff7f 0080 00 08 ffffffff 000080 ff ffffffff 4fddf3f0",
    ),
    (
        DISARM,
        "5346 02 02 01 00 0000 00000000 0100000000000000 0000000000000000 00 00 d007 "
        "00000000 00000000 00000000 0000000000000000 6d33beb2",
    ),
    (
        base.SAMPLE,
        "5346 02 04 00 09 0300 e8030000 00c2eb0b00000000 efcdab89 dc050000 2efbffff "
        "d204 81 03 2900 7b00 02 000000 591b0000 00000000",
    ),
    (
        base.ORDER,
        "5346 02 05 00 01 0300 4d000000 00401e18240a0600 4004fb0b00000000 2a00 f401 "
        "2c01 0000 0000 e803 0000 0000 0000 3700 02 000000",
    ),
    (
        base.QUIET,
        "5346 02 05 00 00 0700 01000000 0500000000000000 0000000000000000 0000 f401 "
        "0000 0000 0000 0000 0000 0000 0000 0000 00 000000",
    ),
    (
        BASE_LIMITS,
        "5346 02 04 00 1f ffff ffffffff ffffffffffffffff ffffffff ffffffff ffffffff "
        "ffff ff 07 ffff ffff 10 000000 00000080 00000000",
    ),
]
EXAMPLES = [SAMPLE, ORDER, PIECE, base.SAMPLE, base.ORDER]


def unsigned(bits):
    return st.integers(0, (1 << bits) - 1)


def signed(bits):
    return st.integers(-(1 << bits - 1), (1 << bits - 1) - 1)


TELEMETRY = st.builds(
    Telemetry, link=st.integers(1, 255), flags=st.integers(0, 63), boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32), clock=unsigned(64), echo=unsigned(32), turnaround=unsigned(32),
    position=signed(32), velocity=signed(32), current=signed(16),
    mode=st.sampled_from([0, 1, 11, 21]),
    slow_id=st.sampled_from(Slow), status=unsigned(32), torque=signed(24), torque_age=unsigned(8),
    slow_value=signed(32),
)  # fmt: skip
COMMANDS = st.builds(
    Command, link=st.integers(1, 255), flags=st.sampled_from([0, 1, 2, 5, 8, 9, 10, 13, 17]),
    boot=st.integers(1, 0xFFFF), sequence=unsigned(32), clock=unsigned(64),
    expiry=st.integers(1, (1 << 64) - 1), mode=st.sampled_from([0, 1, 11, 21]),
    watchdog=st.integers(1, 0xFFFF), set_point=signed(32), velocity=st.integers(0, (1 << 31) - 1),
    acceleration=st.integers(0, (1 << 31) - 1),
)  # fmt: skip
FOLLOWS = st.builds(
    lambda command, path: replace(command, mode=Mode.PATH, set_point=path),
    COMMANDS,
    st.integers(1, 0xFFFF),
)
SEGMENTS = st.builds(
    Segment, link=st.integers(1, 255), flags=st.just(0), boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32), clock=unsigned(64), path=st.integers(1, 0xFFFF),
    index=st.integers(0, 0xFFFE), begin=st.integers(0, (1 << 64) - 60_000_001),
    duration=st.integers(1000, 60_000_000), position=signed(32), velocity=signed(32),
    end_position=signed(32), end_velocity=signed(32),
)  # fmt: skip
LASTS = st.builds(lambda segment: replace(segment, flags=LAST_SEGMENT, end_velocity=0), SEGMENTS)
BASE_TELEMETRY = st.builds(
    BaseTelemetry,
    link=st.just(0),
    flags=st.integers(0, 31),
    boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32),
    clock=unsigned(64),
    echo=unsigned(32),
    turnaround=unsigned(32),
    gyro_sum=unsigned(32),
    gyro_samples=unsigned(16),
    valves=unsigned(8),
    gripper=st.integers(0, 7),
    pulse=unsigned(16),
    pulse_age=unsigned(16),
    slow_id=st.sampled_from(BaseSlow),
    slow_value=signed(32),
)
PULSES = st.builds(
    BaseCommand, link=st.just(0), flags=st.just(1), boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32), clock=unsigned(64), expiry=st.integers(1, (1 << 64) - 1),
    pulse=st.integers(1, 0xFFFF), watchdog=st.integers(1, 0xFFFF),
    on_times=st.tuples(*8 * [unsigned(16)]), gripper=st.integers(0, 2),
)  # fmt: skip
OTHERS = st.builds(
    lambda command, flags: replace(command, flags=flags, pulse=0, on_times=8 * (0,), gripper=0),
    PULSES,
    st.sampled_from([0, 1, 2]),
)
FRAMES = TELEMETRY | COMMANDS | FOLLOWS | SEGMENTS | LASTS | BASE_TELEMETRY | PULSES | OTHERS


def protocol_of(frame):
    return board if isinstance(frame, BaseTelemetry | BaseCommand) else links


def encode(frame, key=None):
    return protocol_of(frame).encode(frame, key)


def patched(frame, at, value):
    data = bytearray(encode(frame))
    data[at : at + len(value)] = value
    return with_crc(bytes(data))


def refusal(data, protocol=links, key=None):
    with pytest.raises(FrameError) as error:
        protocol.decode(data, key)
    return error.value.reason


@pytest.mark.parametrize(("frame", "text"), CASES)
def test_the_table_holds_in_both_directions(frame, text):
    data = bytes.fromhex(text)
    data = data + bytes(16) if len(data) == 56 else with_crc(data + bytes(20))
    assert len(data) == FRAME_SIZE
    assert encode(frame) == data
    assert protocol_of(frame).decode(data) == frame


@given(FRAMES, st.none() | st.binary(min_size=16, max_size=32))
def test_every_frame_comes_back_and_the_other_protocol_refuses_its_kind(frame, key):
    data, own = encode(frame, key), protocol_of(frame)
    assert own.decode(data, key) == frame
    assert data[:56] == encode(frame)[:56]  # but for its signature the same
    assert refusal(data, links if own is board else board, key) is Refusal.KIND


@pytest.mark.parametrize("frame", EXAMPLES)
def test_any_flipped_bit_is_refused(frame):
    for bit in range(8 * FRAME_SIZE):
        flipped = bytearray(encode(frame))
        flipped[bit // 8] ^= 1 << bit % 8
        refusal(bytes(flipped), protocol_of(frame))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", Refusal.LENGTH),
        (encode(SAMPLE)[:-1], Refusal.LENGTH),
        (encode(SAMPLE) + b"\0", Refusal.LENGTH),
        (patched(SAMPLE, 0, b"FS"), Refusal.MAGIC),
        (patched(SAMPLE, 2, b"\1"), Refusal.VERSION),
        (patched(SAMPLE, 3, b"\0"), Refusal.KIND),
        (patched(SAMPLE, 3, b"\6"), Refusal.KIND),
        (encode(SAMPLE)[:52] + bytes(20), Refusal.CRC),
        (encode(SAMPLE)[:-1] + b"\1", Refusal.SIGNATURE),
    ],
)
def test_each_damage_has_its_reason(data, reason):
    assert refusal(data) is reason


@pytest.mark.parametrize(
    ("frame", "at", "value"),
    [
        (SAMPLE, 4, b"\0"),  # link
        (SAMPLE, 5, b"\x40"),  # flags
        (SAMPLE, 6, b"\0\0"),  # boot
        (SAMPLE, 38, b"\2"),  # mode
        (SAMPLE, 38, b"\x1f"),  # a path is for commands
        (SAMPLE, 39, b"\x0a"),  # slow id
        (ORDER, 5, b"\3"),  # arm and stop
        (DISARM, 5, b"\x10"),  # home without arm
        (ORDER, 5, b"\x21"),  # no such flag
        (ORDER, 6, b"\0\0"),  # arms whatever boot
        (ORDER, 20, bytes(8)),  # arms without expiry
        (ORDER, 29, b"\1"),  # reserved
        (ORDER, 30, b"\0\0"),  # watchdog
        (ORDER, 39, b"\x80"),  # profile velocity
        (ORDER, 51, b"\1"),  # reserved
        (FOLLOW, 32, bytes(4)),  # no path
        (FOLLOW, 32, b"\0\0\1\0"),  # path 65536
        (PIECE, 5, b"\2"),  # flags
        (PIECE, 6, b"\0\0"),  # boot
        (PIECE, 20, b"\0\0"),  # path
        (PIECE, 22, b"\xff\xff"),  # index
        (PIECE, 32, b"\xe7\3\0\0"),  # 999 us
        (PIECE, 32, b"\1\x87\x93\3"),  # 60.000001 s
        (PIECE, 48, b"\1"),  # it would end moving
        (MAXIMAL_SEGMENT, 24, bytes([255]) * 8),  # end beyond 64 bits
        (base.SAMPLE, 4, b"\1"),  # another number than the board's
        (base.SAMPLE, 5, b"\x20"),  # flags
        (base.SAMPLE, 6, b"\0\0"),  # boot
        (base.SAMPLE, 35, b"\x08"),  # gripper
        *((base.SAMPLE, 40, bytes([slow_id])) for slow_id in (0, 17)),
        *((base.SAMPLE, at, b"\1") for at in (41, 42, 43, 48, 49, 50, 51)),  # reserved
        (base.ORDER, 4, b"\2"),
        (base.ORDER, 5, b"\3"),  # arm and stop
        (base.ORDER, 5, b"\5"),  # no such flag
        (base.ORDER, 5, b"\0"),  # a pulse without arm
        (base.ORDER, 5, b"\2"),  # a pulse with a stop
        (base.ORDER, 6, b"\0\0"),  # arms whatever boot
        (base.ORDER, 20, bytes(8)),  # arms without expiry
        (base.ORDER, 28, b"\0\0"),  # on times without a pulse
        (base.ORDER, 30, b"\0\0"),  # watchdog
        (base.ORDER, 48, b"\3"),  # gripper
        *((base.ORDER, at, b"\1") for at in (49, 50, 51)),  # reserved
        (base.QUIET, 28, b"\1"),  # a pulse without arm
        (base.QUIET, 48, b"\1"),  # gripper without arm
    ],
)
def test_what_has_no_meaning_is_refused_as_a_field(frame, at, value):
    assert refusal(patched(frame, at, value), protocol_of(frame)) is Refusal.FIELD


@pytest.mark.parametrize(
    ("frame", "changes", "words"),
    [
        (SAMPLE, {"torque": 1 << 23}, "torque is 8388608, expected -8388608 to 8388607"),
        (SAMPLE, {"link": 256}, "link is 256, expected 0 to 255"),
        (SAMPLE, {"slow_id": 0}, "slow_id is 0, expected 1 to 9"),
        (SAMPLE, {"mode": 31}, r"mode is 31, expected one of \[0, 1, 11, 21\]"),
        (FOLLOW, {"set_point": 0}, "path is 0, expected 1 to 65535"),
        (PIECE, {"index": 65535}, "index is 65535, expected 0 to 65534"),
        (PIECE, {"duration": 999}, "duration is 999 us, expected 1000 to 60000000"),
        (PIECE, {"end_velocity": -1}, "end_velocity is -1 in a last segment, expected 0"),
        (ORDER, {"set_point": 1 << 31}, "set_point is 2147483648"),
        (ORDER, {"expiry": 0}, "expiry is 0 in a command that arms"),
        (base.SAMPLE, {"gyro_sum": 1 << 32}, "gyro_sum is 4294967296, expected 0 to 4294967295"),
        (base.SAMPLE, {"gripper": 8}, "gripper is 8, expected 0 to 7"),
        (base.SAMPLE, {"slow_id": 17}, "slow_id is 17, expected 1 to 16"),
        (base.ORDER, {"link": 1}, "link is 1, expected 0"),
        (base.ORDER, {"on_times": 7 * (0,)}, "on_times are .*, expected 8 from 0 to 65535"),
        (base.ORDER, {"on_times": (*7 * (0,), 65536)}, "on_times are .*65536.*, expected 8"),
        (base.ORDER, {"on_times": (-1, *7 * (0,))}, "on_times are .*-1.*, expected 8 from 0"),
        (base.ORDER, {"pulse": 0}, "on_times without a pulse"),
        (base.ORDER, {"flags": BaseCommandFlag.STOP}, "a pulse or a gripper command without arm"),
        (base.ORDER, {"expiry": 0}, "expiry is 0 in a command that arms"),
    ],
)
def test_values_that_make_no_frame_are_named(frame, changes, words):
    with pytest.raises(FrameError, match=words):
        encode(replace(frame, **changes))


def test_sequence_numbers_wrap():
    assert newer(1, 0)
    assert newer(0, 0xFFFFFFFF)
    assert newer(0x7FFFFFFF, 0)
    assert not newer(0, 0)
    assert not newer(0xFFFFFFFF, 0)
    assert not newer(0x80000000, 0)


@pytest.mark.parametrize(
    ("page", "frames", "order"),
    [
        ("protocol.md", [SAMPLE, ORDER, PIECE], ORDER),
        ("base_protocol.md", [base.SAMPLE, base.ORDER], base.ORDER),
    ],
)
def test_the_examples_in_the_documentation_are_these_frames(page, frames, order):
    text = (Path(__file__).parents[3] / "docs/reference" / page).read_text()
    examples = re.findall(r"```\n([0-9a-f\s]+)```", text)
    expected = [*map(encode, frames), encode(order, KEY), pack(encode(order, KEY))]
    assert [bytes.fromhex(example) for example in examples] == expected


@pytest.mark.parametrize("key", [None, KEY[:-1], bytes(16), bytes(32)])
def test_a_signature_is_good_under_its_key_alone(key):
    assert refusal(encode(SAMPLE, KEY), key=key) is Refusal.SIGNATURE


def test_the_signature_is_keyed_blake2s():
    """Signatures computed by OpenSSL: openssl mac -macopt hexkey:KEY -macopt size:16 BLAKE2SMAC."""
    assert encode(SAMPLE, KEY)[56:].hex() == "3bade87061685d603aa7a1917e84e1d7"


# --- whatever comes ------------------------------------------------------------------------------

KINDS = 8
POOL = 1 << 16


def damaged(rng, frame, noise, kind, key):
    """An input of one of the kinds; the last four get a new CRC, the last two a signature, too."""
    at = rng.randrange(POOL - 200)
    if kind == 0:
        return noise[at : at + FRAME_SIZE]
    if kind == 1:
        return noise[at : at + rng.randrange(120)]
    if kind == 2:
        return frame[: rng.randrange(FRAME_SIZE)] + noise[at : at + rng.choice((0, 1, FRAME_SIZE))]
    data = bytearray(frame)
    if kind == 3:
        data[at % FRAME_SIZE] ^= 1 << (at & 7)
    elif kind in (4, 5):
        data[at % 56] = noise[at]
        data = with_crc(data)
    elif kind == 6:
        data[4 + at % 48] = noise[at]
        data = sealed(data, key)
    else:
        data[4:52] = noise[at : at + 48]
        data = sealed(data, key)
    return bytes(data)


@pytest.mark.parametrize("inputs", [80_000, pytest.param(10_000_000, marks=pytest.mark.slow)])
def test_whatever_comes_is_a_frame_that_encodes_to_itself_or_is_refused(inputs):
    rng, reasons, frames = random.Random(6), Counter(), 0
    noise, stream, found = rng.randbytes(POOL), StreamDecoder(), 0
    originals = [(encode(f, key), key, protocol_of(f)) for f in EXAMPLES for key in (None, KEY)]
    before = 0
    for k in range(inputs):
        frame, key, protocol = originals[k % len(originals)]
        data = damaged(rng, frame, noise, k // len(originals) % KINDS, key)
        try:
            got = protocol.decode(data, key)
        except FrameError as error:
            reasons[error.reason] += 1
        else:
            frames += 1
            assert protocol.encode(got, key) == data
        if k % 16 == 0:  # a frame on a stream, after whatever came before it
            found += frame in stream.feed(data + pack(frame))
        if k % POOL == 0:
            noise = rng.randbytes(POOL)
        if k == inputs // 5:
            before = memory()
    assert memory() - before < 4_000_000
    assert found == (inputs + 15) // 16
    assert set(reasons) == set(Refusal)
    assert frames > inputs // 50
