"""The wire protocol: one table for both directions, every damage refused."""

import re
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from driver_frames import KEY, ORDER, PIECE, SAMPLE, with_crc
from hypothesis import given
from hypothesis import strategies as st

from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    Telemetry,
    decode,
    encode,
)
from fss_link.protocol import (
    FRAME_SIZE,
    FrameError,
    KeyFileError,
    Refusal,
    load_keys,
    newer,
    pack,
    parse_keys,
)

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
CASES = [
    (SAMPLE, "5346 02 01 02 09 0300 e8030000 00c2eb0b00000000 efcdab89 dc050000 c063ffff "
     "c7cfffff b5ff 15 02 00000008 feffff 0c f0000000 c6c8cbff"),
    (ORDER, "5346 02 02 02 01 0300 4d000000 00401e18240a0600 4004fb0b00000000 15 00 d007 "
     "409c0000 14d40500 d71d0000 0000000000000000 3e9cc256"),
    (FOLLOW, "5346 02 02 02 01 0300 4f000000 02401e18240a0600 4004fb0b00000000 1f 00 d007 "
     "ffff0000 14d40500 d71d0000 0000000000000000 32e9d2a9"),
    (PIECE, "5346 02 03 02 01 0300 4e000000 01401e18240a0600 0700 0400 80460a0c00000000 "
     "a0252600 409c0000 35950000 20d1ffff 00000000 23671909"),
    (MAXIMAL_SEGMENT, "5346 02 03 ff 00 ffff ffffffff ffffffffffffffff ffff feff "
     "ff786cfcffffffff 00879303 00000080 ffffff7f ffffff7f 00000080 69ac41f2"),
    (LIMITS, "5346 02 01 ff 3f ffff ffffffff ffffffffffffffff ffffffff ffffffff 00000080 "
     "ffffff7f 0080 00 08 ffffffff 000080 ff ffffffff 4fddf3f0"),
    (DISARM, "5346 02 02 01 00 0000 00000000 0100000000000000 0000000000000000 00 00 d007 "
     "00000000 00000000 00000000 0000000000000000 6d33beb2"),
]  # fmt: skip
NO_SIGNATURE = bytes(16)


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
    COMMANDS, st.integers(1, 0xFFFF),
)  # fmt: skip
SEGMENTS = st.builds(
    Segment, link=st.integers(1, 255), flags=st.just(0), boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32), clock=unsigned(64), path=st.integers(1, 0xFFFF),
    index=st.integers(0, 0xFFFE), begin=st.integers(0, (1 << 64) - 60_000_001),
    duration=st.integers(1000, 60_000_000), position=signed(32), velocity=signed(32),
    end_position=signed(32), end_velocity=signed(32),
)  # fmt: skip
LASTS = st.builds(lambda segment: replace(segment, flags=LAST_SEGMENT, end_velocity=0), SEGMENTS)
FRAMES = TELEMETRY | COMMANDS | FOLLOWS | SEGMENTS | LASTS


def patched(frame, at, value):
    data = bytearray(encode(frame))
    data[at : at + len(value)] = value
    return with_crc(bytes(data))


def refusal(data):
    with pytest.raises(FrameError) as error:
        decode(data)
    return error.value.reason


@pytest.mark.parametrize(("frame", "text"), CASES)
def test_the_table_holds_in_both_directions(frame, text):
    data = bytes.fromhex(text) + NO_SIGNATURE
    assert encode(frame) == data
    assert decode(data) == frame
    assert len(data) == FRAME_SIZE


@given(FRAMES)
def test_every_frame_comes_back(frame):
    assert decode(encode(frame)) == frame


@pytest.mark.parametrize("frame", [SAMPLE, ORDER, PIECE])
def test_any_flipped_bit_is_refused(frame):
    data = encode(frame)
    for bit in range(8 * FRAME_SIZE):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        refusal(bytes(flipped))


@given(st.binary(max_size=2 * FRAME_SIZE) | st.binary(min_size=FRAME_SIZE, max_size=FRAME_SIZE))
def test_noise_is_refused_and_nothing_else_is_raised(data):
    refusal(data)


@given(st.binary(min_size=48, max_size=48), st.sampled_from([1, 2, 3]))
def test_noise_with_a_good_head_and_crc_is_refused_or_encodes_to_itself(noise, kind):
    data = with_crc(struct.pack("<HBB", 0x4653, 2, kind) + noise + bytes(20))
    try:
        frame = decode(data)
    except FrameError:
        assert refusal(data) is Refusal.FIELD
    else:
        assert encode(frame) == data


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", Refusal.LENGTH),
        (encode(SAMPLE)[:-1], Refusal.LENGTH),
        (encode(SAMPLE) + b"\0", Refusal.LENGTH),
        (patched(SAMPLE, 0, b"FS"), Refusal.MAGIC),
        (patched(SAMPLE, 2, b"\1"), Refusal.VERSION),
        (patched(SAMPLE, 3, b"\0"), Refusal.KIND),
        (patched(SAMPLE, 3, b"\4"), Refusal.KIND),  # the base's board's
        (patched(ORDER, 3, b"\5"), Refusal.KIND),
        (encode(SAMPLE)[:52] + bytes(20), Refusal.CRC),
        (encode(SAMPLE)[:-1] + b"\1", Refusal.SIGNATURE),
        (patched(SAMPLE, 4, b"\0"), Refusal.FIELD),  # link
        (patched(SAMPLE, 5, b"\x40"), Refusal.FIELD),  # flags
        (patched(SAMPLE, 6, b"\0\0"), Refusal.FIELD),  # boot
        (patched(SAMPLE, 38, b"\2"), Refusal.FIELD),  # mode
        (patched(SAMPLE, 38, b"\x1f"), Refusal.FIELD),  # a path is for commands
        (patched(SAMPLE, 39, b"\x0a"), Refusal.FIELD),  # slow id
        (patched(ORDER, 5, b"\3"), Refusal.FIELD),  # arm and stop
        (patched(DISARM, 5, b"\x10"), Refusal.FIELD),  # home without arm
        (patched(ORDER, 5, b"\x21"), Refusal.FIELD),  # no such flag
        (patched(ORDER, 6, b"\0\0"), Refusal.FIELD),  # arms whatever boot
        (patched(ORDER, 20, bytes(8)), Refusal.FIELD),  # arms without expiry
        (patched(ORDER, 29, b"\1"), Refusal.FIELD),  # reserved
        (patched(ORDER, 30, b"\0\0"), Refusal.FIELD),  # watchdog
        (patched(ORDER, 39, b"\x80"), Refusal.FIELD),  # profile velocity
        (patched(ORDER, 51, b"\1"), Refusal.FIELD),  # reserved
        (patched(FOLLOW, 32, bytes(4)), Refusal.FIELD),  # no path
        (patched(FOLLOW, 32, b"\0\0\1\0"), Refusal.FIELD),  # path 65536
        (patched(PIECE, 5, b"\2"), Refusal.FIELD),  # flags
        (patched(PIECE, 6, b"\0\0"), Refusal.FIELD),  # boot
        (patched(PIECE, 20, b"\0\0"), Refusal.FIELD),  # path
        (patched(PIECE, 22, b"\xff\xff"), Refusal.FIELD),  # index
        (patched(PIECE, 32, b"\xe7\3\0\0"), Refusal.FIELD),  # 999 us
        (patched(PIECE, 32, b"\1\x87\x93\3"), Refusal.FIELD),  # 60.000001 s
        (patched(PIECE, 48, b"\1"), Refusal.FIELD),  # it would end moving
        (patched(MAXIMAL_SEGMENT, 24, bytes([255]) * 8), Refusal.FIELD),  # end beyond 64 bits
    ],
)
def test_each_damage_has_its_reason(data, reason):
    assert refusal(data) is reason


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


def test_the_examples_in_the_documentation_are_these_frames():
    text = Path(__file__, "../../../../docs/reference/protocol.md").resolve().read_text()
    examples = re.findall(r"```\n([0-9a-f\s]+)```", text)
    signed_order = encode(ORDER, KEY)
    frames = [encode(SAMPLE), encode(ORDER), encode(PIECE), signed_order, pack(signed_order)]
    assert [bytes.fromhex(example) for example in examples] == frames


@given(FRAMES, st.binary(min_size=16, max_size=32))
def test_a_signed_frame_is_the_unsigned_one_but_for_its_signature(frame, key):
    data = encode(frame, key)
    assert data[:56] == encode(frame)[:56]
    assert decode(data, key) == frame


@pytest.mark.parametrize("key", [None, KEY[:-1], bytes(16), bytes(32)])
def test_a_signature_is_good_under_its_key_alone(key):
    with pytest.raises(FrameError) as error:
        decode(encode(SAMPLE, KEY), key)
    assert error.value.reason is Refusal.SIGNATURE


def test_the_signature_is_keyed_blake2s():
    """Signatures computed by OpenSSL: openssl mac -macopt hexkey:KEY -macopt size:16 BLAKE2SMAC."""
    assert encode(SAMPLE, KEY)[56:].hex() == "3bade87061685d603aa7a1917e84e1d7"


def test_keys_are_read_by_link():
    text = f"# keys\n0 {'0a' * 16}\n\n 12\t{'FF' * 32}  # the last\n"
    assert parse_keys(text) == {0: b"\x0a" * 16, 12: b"\xff" * 32}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"256 {'0a' * 16}", "expected a link from 0 to 255 and 32 to 64 hex digits"),
        (f"2 {'0a' * 15}", "expected a link"),
        (f"2 {'0a' * 33}", "expected a link"),
        (f"2 {'0a' * 16}0", "expected a link"),
        ("2", "expected a link"),
        (f"1 {'0b' * 16}", "expected each link and each key once"),
        (f"2 {'00' * 16}", "expected each link and each key once"),
    ],
)
def test_a_line_that_is_no_key_is_named_and_not_shown(line, words):
    with pytest.raises(KeyFileError, match=f"keys, line 2: {words}") as error:
        parse_keys(f"1 {'00' * 16}\n{line}\n")
    assert "0a0a" not in str(error.value)


def test_a_file_of_keys_must_be_its_owners_alone(tmp_path):
    path = tmp_path / "keys"
    path.write_text(f"1 {KEY.hex()}\n")
    path.chmod(0o600)
    assert load_keys(path) == {1: KEY}
    path.chmod(0o640)
    with pytest.raises(KeyFileError, match="has mode 640, expected 600"):
        load_keys(path)
