"""Frames on a byte stream: found again wherever the noise ends."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fss_arm_driver.protocol import FRAME_SIZE, StreamDecoder, pack

FRAMES = st.binary(min_size=FRAME_SIZE, max_size=FRAME_SIZE)
ONE, TWO = bytes(range(72)), bytes(30) + b"\xff" * 42


def unstuffed(data):
    """The textbook's decoder, byte by byte."""
    out, code, left = [], 0xFF, 0
    for byte in data:
        if left:
            out.append(byte)
        else:
            if code != 0xFF:
                out.append(0)
            code = left = byte
        left -= 1
    return bytes(out)


@given(FRAMES)
def test_a_packed_frame_has_no_zero_within_and_the_textbook_reads_it(frame):
    packed = pack(frame)
    assert len(packed) == 75
    assert packed[0] == packed[-1] == 0
    assert 0 not in packed[1:-1]
    assert unstuffed(packed[1:-1]) == frame


@pytest.mark.parametrize("noise", [b"", b"noise", b"\0\0", b"x\0y", bytes(range(256))])
def test_any_split_of_the_stream_gives_the_same_frames(noise):
    stream = noise + pack(ONE) + noise + pack(TWO) + pack(ONE) + noise
    for size in (1, 2, 7, 74, 75, 76, len(stream)):
        decoder = StreamDecoder()
        pieces = [stream[at : at + size] for at in range(0, len(stream), size)]
        got = [frame for piece in pieces for frame in decoder.feed(piece)]
        assert got == [ONE, TWO, ONE]
        assert (decoder.received, decoder.frames) == (len(stream), 3)


@given(st.lists(st.binary(max_size=200), max_size=5), FRAMES)
def test_a_frame_is_found_after_any_noise(noise, frame):
    decoder = StreamDecoder()
    for piece in noise:
        decoder.feed(piece)
    assert decoder.feed(pack(frame))[-1] == frame


def test_a_torn_frame_costs_itself_only():
    for cut in range(75):
        stream = pack(ONE)[:cut] + pack(TWO)
        assert StreamDecoder().feed(stream) == [TWO] if cut < 74 else [ONE, TWO]


def test_endless_noise_is_not_kept():
    decoder, rng = StreamDecoder(), random.Random(1)
    for _ in range(1000):
        assert not decoder.feed(rng.randbytes(1000).replace(b"\0", b"\1"))
    assert len(decoder._rest) <= FRAME_SIZE + 2
