"""Ten million noisy, damaged and forged inputs to the codec and the stream decoder."""

import random
import time
from collections import Counter
from dataclasses import replace
from hashlib import blake2s
from pathlib import Path
from struct import pack_into
from zlib import crc32

import pytest

from fss_arm_driver.protocol import (
    FRAME_SIZE,
    LAST,
    Command,
    FrameError,
    Mode,
    Order,
    Refusal,
    Segment,
    Slow,
    State,
    StreamDecoder,
    Telemetry,
    decode,
    encode,
    pack,
)

KEY = bytes(range(20))
SAMPLE = Telemetry(
    link=2, flags=State.ARMED | State.REFERENCED, boot=3, sequence=1000, clock=200_000_000,
    echo=0x89ABCDEF, turnaround=1500, position=-40000, velocity=-12345, current=-75,
    mode=Mode.POSITION, slow_id=Slow.SUPPLY, status=0x08000000, torque=-2, torque_age=12,
    slow_value=240,
)  # fmt: skip
ORDER = Command(
    link=2, flags=Order.ARM, boot=3, sequence=77, clock=1_700_000_000_000_000,
    expiry=201_000_000, mode=Mode.POSITION, watchdog=2000, set_point=40000, velocity=381972,
    acceleration=7639,
)  # fmt: skip
PIECE = Segment(
    link=2, flags=LAST, boot=3, sequence=78, clock=1_700_000_000_000_001, path=7, index=4,
    begin=202_000_000, duration=2_500_000, position=40000, velocity=38197, end_position=-12000,
    end_velocity=0,
)  # fmt: skip
KINDS = 8
POOL = 1 << 16


def seal(data, key):
    """CRC and signature put right."""
    pack_into("<I", data, 52, crc32(data[:52]))
    data[56:] = blake2s(data[:56], digest_size=16, key=key).digest() if key else bytes(16)


def damaged(rng, frame, noise, kind, key):
    """An input of one of the kinds; the last two are sealed anew."""
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
        pack_into("<I", data, 52, crc32(data[:52]))
    elif kind == 6:
        data[4 + at % 48] = noise[at]
        seal(data, key)
    else:
        data[4:52] = noise[at : at + 48]
        seal(data, key)
    return bytes(data)


def memory():
    """Resident memory [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.parametrize("inputs", [80_000, pytest.param(10_000_000, marks=pytest.mark.slow)])
def test_whatever_comes_is_a_frame_that_encodes_to_itself_or_is_refused(inputs, capsys):
    rng, reasons, frames = random.Random(6), Counter(), 0
    noise, stream, found = rng.randbytes(POOL), StreamDecoder(), 0
    originals = [(encode(f, key), key) for f in (SAMPLE, ORDER, PIECE) for key in (None, KEY)]
    before, begun = 0, time.perf_counter()
    for k in range(inputs):
        frame, key = originals[k % len(originals)]
        data = damaged(rng, frame, noise, k // len(originals) % KINDS, key)
        try:
            got = decode(data, key)
        except FrameError as error:
            reasons[error.reason] += 1
        else:
            frames += 1
            assert encode(got, key) == data
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
    if inputs > 100_000:
        with capsys.disabled():
            took = 1e6 * (time.perf_counter() - begun) / inputs
            print(f"\n  {inputs} inputs, {frames} frames, {took:.1f} us each: {dict(reasons)}")


def test_a_damaged_frame_that_is_sealed_anew_is_no_forgery_without_the_key():
    forged = bytearray(encode(replace(ORDER, set_point=0), KEY))
    seal(forged, bytes(16))
    with pytest.raises(FrameError) as error:
        decode(bytes(forged), KEY)
    assert error.value.reason is Refusal.SIGNATURE
