"""The frames of links and of the base's board: one table for both directions, damage refused."""

import random
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import ModuleType

import base_board as base
import pytest
from driver_frames import KEY, ORDER, PIECE, SAMPLE, with_crc
from firmware import BASE, Core
from firmware_vectors import (
    KEYS,
    base_commands,
    base_telemetries,
    commands,
    damaged,
    segments,
    telemetries,
)
from running import memory

from fss_arm_driver import protocol as links
from fss_arm_driver.protocol import Command, LinkCommandFlag, Mode, Segment, Slow, Telemetry
from fss_base_driver import protocol as board
from fss_base_driver.protocol import BaseCommand, BaseCommandFlag, BaseTelemetry
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
    (base.SAMPLE, "5346 02 04 00 09 0300 e8030000 00c2eb0b00000000 efcdab89 dc050000 2efbffff "
     "d204 81 03 2900 7b00 02 000000 591b0000 00000000"),
    (base.ORDER, "5346 02 05 00 01 0300 4d000000 00401e18240a0600 4004fb0b00000000 2a00 f401 "
     "2c01 0000 0000 e803 0000 0000 0000 3700 02 000000"),
    (base.QUIET, "5346 02 05 00 00 0700 01000000 0500000000000000 0000000000000000 0000 f401 "
     "0000 0000 0000 0000 0000 0000 0000 0000 00 000000"),
    (BASE_LIMITS, "5346 02 04 00 1f ffff ffffffff ffffffffffffffff ffffffff ffffffff ffffffff "
     "ffff ff 07 ffff ffff 10 000000 00000080 00000000"),
]  # fmt: skip
EXAMPLES = [SAMPLE, ORDER, PIECE, base.SAMPLE, base.ORDER]


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


@pytest.mark.parametrize(
    "generate", [telemetries, commands, segments, base_telemetries, base_commands]
)
def test_every_frame_comes_back_and_the_other_protocol_refuses_its_kind(generate):
    rng = random.Random(1)
    for frame in islice(generate(rng), 200):
        key = rng.choice(KEYS)
        data, own = encode(frame, key), protocol_of(frame)
        assert own.decode(data, key) == frame
        assert data[:56] == encode(frame)[:56]  # only the signature differs
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


#: Places and bytes that make a frame meaningless although its CRC is correct.
MEANINGLESS = [
    # link, flags, boot, mode, the mode of a path (for commands only), slow id
    (SAMPLE, (4, "00"), (5, "40"), (6, "0000"), (38, "02"), (38, "1f"), (39, "0a")),
    # arm and stop, no such flag, arms with any boot, arms without expiry, watchdog, velocity
    (ORDER, (5, "03"), (5, "21"), (6, "0000"), (20, 8 * "00"), (30, "0000"), (39, "80")),
    (ORDER, (4, "00"), (28, "02"), (29, "01"), (51, "01")),  # link, mode, reserved
    (DISARM, (5, "10")),  # home without arm
    (FOLLOW, (32, 4 * "00"), (32, "00000100")),  # path 0, path 65536
    # flags, boot, path, index, 999 us, 60.000001 s, it would end in motion
    (PIECE, (5, "02"), (6, "0000"), (20, "0000"), (22, "ffff"), (32, "e7030000"), (32, "01879303")),
    (PIECE, (48, "01"), (4, "00")),  # and link
    (MAXIMAL_SEGMENT, (24, 8 * "ff")),  # its end exceeds 64 bits
    # number of a link, flags, boot, gripper, slow ids, reserved
    (base.SAMPLE, (4, "01"), (5, "20"), (6, "0000"), (35, "08"), (40, "00"), (40, "11")),
    (base.SAMPLE, *((at, "01") for at in (41, 42, 43, 48, 49, 50, 51))),
    # number of a link, arm and stop, no such flag, a pulse without arm and with a stop
    (base.ORDER, (4, "02"), (5, "03"), (5, "05"), (5, "00"), (5, "02")),
    # arms with any boot, arms without expiry, on times without a pulse, watchdog, gripper
    (base.ORDER, (6, "0000"), (20, 8 * "00"), (28, "0000"), (30, "0000"), (48, "03")),
    (base.ORDER, *((at, "01") for at in (49, 50, 51))),  # reserved
    (base.QUIET, (28, "01"), (48, "01")),  # pulse and gripper without arm
]


@pytest.mark.parametrize("row", MEANINGLESS)
def test_what_has_no_meaning_is_refused_as_a_field(row):
    frame, *changes = row
    for at, value in changes:
        data = patched(frame, at, bytes.fromhex(value))
        assert refusal(data, protocol_of(frame)) is Refusal.FIELD, (at, value)


@pytest.fixture(scope="module")
def cores() -> Iterator[dict[ModuleType, Core]]:
    cores = {links: Core(), board: Core(package=BASE)}
    yield cores
    for core in cores.values():
        core.close()


ORDERS = [row for row in MEANINGLESS if not isinstance(row[0], Telemetry | BaseTelemetry)]


@pytest.mark.parametrize("row", ORDERS)
def test_the_firmware_refuses_it_too(row, cores):
    frame, *changes = row
    for at, value in changes:
        data = patched(frame, at, bytes.fromhex(value))
        answer = cores[protocol_of(frame)].ask(f"decode - {data.hex()}")
        assert answer == "field", (at, value)


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
    ("page", "frames", "signed"),
    [
        ("protocol.md", [SAMPLE, ORDER, PIECE], [encode(ORDER, KEY), pack(encode(ORDER, KEY))]),
        ("base_protocol.md", [base.SAMPLE, base.ORDER], []),
    ],
)
def test_the_examples_in_the_documentation_are_these_frames(page, frames, signed):
    text = (Path(__file__).parents[3] / "docs/reference" / page).read_text()
    examples = re.findall(r"```\n([0-9a-f\s]+)```", text)
    assert [bytes.fromhex(example) for example in examples] == [*map(encode, frames), *signed]


@pytest.mark.parametrize("key", [None, KEY[:-1], bytes(16), bytes(32)])
def test_a_signature_is_good_under_its_key_alone(key):
    assert refusal(encode(SAMPLE, KEY), key=key) is Refusal.SIGNATURE


def test_the_signature_is_keyed_blake2s():
    """Signatures computed by OpenSSL: openssl mac -macopt hexkey:KEY -macopt size:16 BLAKE2SMAC."""
    assert encode(SAMPLE, KEY)[56:].hex() == "3bade87061685d603aa7a1917e84e1d7"


# --- whatever comes ------------------------------------------------------------------------------


@pytest.mark.parametrize("inputs", [20_000, pytest.param(10_000_000, marks=pytest.mark.slow)])
def test_whatever_comes_is_a_frame_that_encodes_to_itself_or_is_refused(inputs):
    rng, reasons, frames, found, before = random.Random(6), Counter(), 0, 0, 0
    stream = StreamDecoder()
    originals = [(encode(f, key), key, protocol_of(f)) for f in EXAMPLES for key in KEYS]
    for k in range(inputs):
        frame, key, protocol = originals[k % len(originals)]
        data = damaged(rng, frame, key)
        try:
            got = protocol.decode(data, key)
        except FrameError as error:
            reasons[error.reason] += 1
        else:
            frames += 1
            assert protocol.encode(got, key) == data
        if k % 16 == 0:  # a frame on a stream, after whatever came before it
            found += frame in stream.feed(data + pack(frame))
        if k == inputs // 5:
            before = memory()
    assert memory() - before < 4_000_000
    assert found == (inputs + 15) // 16
    assert set(reasons) == set(Refusal)
    assert frames > inputs // 50
