"""The wire protocol of the base's board: one table for both directions, every damage refused."""

import re
import struct
from dataclasses import replace
from pathlib import Path

import driver_link
import pytest
from base_board import KEY, ORDER, QUIET, SAMPLE
from driver_frames import with_crc
from hypothesis import given
from hypothesis import strategies as st

from fss_arm_driver import protocol as links
from fss_base_driver.protocol import (
    BaseCommand,
    BaseCommandFlag,
    BaseSlow,
    BaseTelemetry,
    decode,
    encode,
)
from fss_link.protocol import FrameError, Refusal, pack

LIMITS = BaseTelemetry(
    link=0, flags=31, boot=0xFFFF, sequence=0xFFFFFFFF, clock=(1 << 64) - 1, echo=0xFFFFFFFF,
    turnaround=0xFFFFFFFF, gyro_sum=0xFFFFFFFF, gyro_samples=0xFFFF, valves=255, gripper=7,
    pulse=0xFFFF, pulse_age=0xFFFF, slow_id=16, slow_value=-(1 << 31),
)  # fmt: skip
CASES = [
    (SAMPLE, "5346 02 04 00 09 0300 e8030000 00c2eb0b00000000 efcdab89 dc050000 2efbffff "
     "d204 81 03 2900 7b00 02 000000 591b0000 00000000"),
    (ORDER, "5346 02 05 00 01 0300 4d000000 00401e18240a0600 4004fb0b00000000 2a00 f401 "
     "2c01 0000 0000 e803 0000 0000 0000 3700 02 000000"),
    (QUIET, "5346 02 05 00 00 0700 01000000 0500000000000000 0000000000000000 0000 f401 "
     "0000 0000 0000 0000 0000 0000 0000 0000 00 000000"),
    (LIMITS, "5346 02 04 00 1f ffff ffffffff ffffffffffffffff ffffffff ffffffff ffffffff "
     "ffff ff 07 ffff ffff 10 000000 00000080 00000000"),
]  # fmt: skip


def unsigned(bits):
    return st.integers(0, (1 << bits) - 1)


TELEMETRY = st.builds(
    BaseTelemetry, link=st.just(0), flags=st.integers(0, 31), boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32), clock=unsigned(64), echo=unsigned(32), turnaround=unsigned(32),
    gyro_sum=unsigned(32), gyro_samples=unsigned(16), valves=unsigned(8),
    gripper=st.integers(0, 7), pulse=unsigned(16), pulse_age=unsigned(16),
    slow_id=st.sampled_from(BaseSlow), slow_value=st.integers(-(1 << 31), (1 << 31) - 1),
)  # fmt: skip
PULSES = st.builds(
    BaseCommand, link=st.just(0), flags=st.just(1), boot=st.integers(1, 0xFFFF),
    sequence=unsigned(32), clock=unsigned(64), expiry=st.integers(1, (1 << 64) - 1),
    pulse=st.integers(1, 0xFFFF), watchdog=st.integers(1, 0xFFFF),
    on_times=st.tuples(*8 * [unsigned(16)]), gripper=st.integers(0, 2),
)  # fmt: skip
OTHERS = st.builds(
    lambda command, flags: replace(command, flags=flags, pulse=0, on_times=8 * (0,), gripper=0),
    PULSES, st.sampled_from([0, 1, 2]),
)  # fmt: skip
FRAMES = TELEMETRY | PULSES | OTHERS


def patched(frame, at, value):
    data = bytearray(encode(frame))
    data[at : at + len(value)] = value
    return with_crc(bytes(data))


def refusal(data, decode=decode):
    with pytest.raises(FrameError) as error:
        decode(data)
    return error.value.reason


@pytest.mark.parametrize(("frame", "text"), CASES)
def test_the_table_holds_in_both_directions(frame, text):
    data = with_crc(bytes.fromhex(text) + bytes(20))
    assert encode(frame) == data
    assert decode(data) == frame


@given(FRAMES)
def test_every_frame_comes_back(frame):
    assert decode(encode(frame)) == frame


@given(FRAMES)
def test_a_link_refuses_its_kind(frame):
    assert refusal(encode(frame), links.decode) is Refusal.KIND


def test_the_board_refuses_the_links_kinds():
    assert refusal(links.encode(driver_link.SAMPLE)) is Refusal.KIND
    for kind in (0, 1, 2, 3, 6):
        assert refusal(patched(SAMPLE, 3, bytes([kind]))) is Refusal.KIND


@pytest.mark.parametrize("frame", [SAMPLE, ORDER])
def test_any_flipped_bit_is_refused(frame):
    for bit in range(8 * 72):
        flipped = bytearray(encode(frame))
        flipped[bit // 8] ^= 1 << bit % 8
        refusal(bytes(flipped))


@given(st.binary(min_size=48, max_size=48), st.sampled_from([4, 5]), st.booleans())
def test_noise_with_a_good_head_and_crc_is_refused_or_encodes_to_itself(noise, kind, addressed):
    noise = b"\0" + noise[1:] if addressed else noise
    data = with_crc(struct.pack("<HBB", 0x4653, 2, kind) + noise + bytes(20))
    try:
        frame = decode(data)
    except FrameError:
        assert refusal(data) is Refusal.FIELD
    else:
        assert encode(frame) == data


@pytest.mark.parametrize(
    "data",
    [
        patched(SAMPLE, 4, b"\1"),  # another number than the board's
        patched(SAMPLE, 5, b"\x20"),  # flags
        patched(SAMPLE, 6, b"\0\0"),  # boot
        patched(SAMPLE, 35, b"\x08"),  # gripper
        patched(SAMPLE, 40, b"\0"),  # slow id
        patched(SAMPLE, 40, b"\x11"),
        *(patched(SAMPLE, at, b"\1") for at in (41, 42, 43, 48, 49, 50, 51)),  # reserved
        patched(ORDER, 4, b"\2"),
        patched(ORDER, 5, b"\3"),  # arm and stop
        patched(ORDER, 5, b"\5"),  # no such flag
        patched(ORDER, 5, b"\0"),  # a pulse without arm
        patched(ORDER, 5, b"\2"),  # a pulse with a stop
        patched(ORDER, 6, b"\0\0"),  # arms whatever boot
        patched(ORDER, 20, bytes(8)),  # arms without expiry
        patched(ORDER, 28, b"\0\0"),  # on times without a pulse
        patched(ORDER, 30, b"\0\0"),  # watchdog
        patched(ORDER, 48, b"\3"),  # gripper
        *(patched(ORDER, at, b"\1") for at in (49, 50, 51)),  # reserved
        patched(QUIET, 28, b"\1"),  # a pulse without arm
        patched(QUIET, 48, b"\1"),  # gripper without arm
    ],
)
def test_what_has_no_meaning_is_refused_as_a_field(data):
    assert refusal(data) is Refusal.FIELD


@pytest.mark.parametrize(
    ("frame", "changes", "words"),
    [
        (SAMPLE, {"gyro_sum": 1 << 32}, "gyro_sum is 4294967296, expected 0 to 4294967295"),
        (SAMPLE, {"gripper": 8}, "gripper is 8, expected 0 to 7"),
        (SAMPLE, {"slow_id": 17}, "slow_id is 17, expected 1 to 16"),
        (ORDER, {"link": 1}, "link is 1, expected 0"),
        (ORDER, {"on_times": 7 * (0,)}, "on_times are .*, expected 8 from 0 to 65535"),
        (ORDER, {"on_times": (*7 * (0,), 65536)}, "on_times are .*65536.*, expected 8 from 0"),
        (ORDER, {"on_times": (-1, *7 * (0,))}, "on_times are .*-1.*, expected 8 from 0"),
        (ORDER, {"pulse": 0}, "on_times without a pulse"),
        (
            ORDER,
            {"flags": BaseCommandFlag.STOP},
            "a pulse or a gripper command without arm",
        ),
        (ORDER, {"expiry": 0}, "expiry is 0 in a command that arms"),
    ],
)
def test_values_that_make_no_frame_are_named(frame, changes, words):
    with pytest.raises(FrameError, match=words):
        encode(replace(frame, **changes))


def test_the_examples_in_the_documentation_are_these_frames():
    text = Path(__file__, "../../../../docs/reference/base_protocol.md").resolve().read_text()
    examples = re.findall(r"```\n([0-9a-f\s]+)```", text)
    signed_order = encode(ORDER, KEY)
    frames = [encode(SAMPLE), encode(ORDER), signed_order, pack(signed_order)]
    assert [bytes.fromhex(example) for example in examples] == frames


@given(FRAMES, st.binary(min_size=16, max_size=32))
def test_a_signed_frame_is_the_unsigned_one_but_for_its_signature(frame, key):
    data = encode(frame, key)
    assert data[:56] == encode(frame)[:56]
    assert decode(data, key) == frame
