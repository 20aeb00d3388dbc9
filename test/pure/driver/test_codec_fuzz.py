"""Ten million noisy, damaged and forged inputs to the codec and the stream decoder."""

import random
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from driver_frames import KEY, ORDER, PIECE, SAMPLE, sealed, with_crc

from fss_arm_driver.protocol import decode, encode
from fss_link.protocol import FRAME_SIZE, FrameError, Refusal, StreamDecoder, pack

KINDS = 8
POOL = 1 << 16


def damaged(rng, frame, noise, kind, key):
    """An input of one of the kinds; the last two get a new CRC."""
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
    forged = sealed(encode(replace(ORDER, set_point=0), KEY), bytes(16))
    with pytest.raises(FrameError) as error:
        decode(forged, KEY)
    assert error.value.reason is Refusal.SIGNATURE
