"""Lines of a DSP-3000, whole, in pieces, cut, and with noise between them."""

from math import radians

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fss_base_driver.dsp3000 import MAX_RATE, Lines

TABLE = [
    (b"12.345678 1", 12.345678),
    (b"-0.000105 1", -0.000105),
    (b"-123.456789 1", -123.456789),
    (b"  001.500000   1 ", 1.5),
    (b"12.345678 0", None),  # a fault
    (b"12.345678 2", None),
    (b"12.34567 1", None),  # a digit is missing
    (b"12.345678", None),
    (b"1234.567890 1", None),
    (b"400.000000 1", None),  # beyond what it measures
    (b"--1.000000 1", None),
    (b"nan 1", None),
    (b"1e2.000000 1", None),
    (b"\xb1\xb2.345678 1", None),
    (b"", None),
]


def lines(data=b"\r\n"):
    """A decoder that has seen an end of line."""
    fresh = Lines()
    fresh.feed(data)
    return fresh


@pytest.mark.parametrize(("line", "rate"), TABLE)
def test_the_table(line, rate):
    decoder = lines()
    got = decoder.feed(line + b"\r\n")
    assert got == [None if rate is None else radians(rate)]
    assert sum(decoder.counts) == 1


def test_a_fault_is_no_noise():
    decoder = lines()
    decoder.feed(b"1.000000 0\r\nx\r\n1.000000 1\r\n")
    assert decoder.counts == (1, 1, 1)


def test_the_rest_of_a_line_that_was_begun_before_is_not_taken_for_one():
    decoder = Lines()
    assert decoder.feed(b"3.456789 1\r\n-123.456789 1\r\n") == [radians(-123.456789)]
    assert decoder.counts == (1, 0, 0)


RATES = st.lists(st.integers(-375_000_000, 375_000_000), min_size=1, max_size=20)


@given(RATES, st.lists(st.integers(1, 30), min_size=1))
def test_any_split_of_the_stream_says_the_same(numbers, sizes):
    stream = b"".join(b"%.6f 1\r\n" % (n / 1e6) for n in numbers)
    whole, pieces, got = lines(), lines(), []
    at = 0
    while at < len(stream):
        for size in sizes:
            got += pieces.feed(stream[at : at + size])
            at += size
    assert got == whole.feed(stream) == pytest.approx([radians(n / 1e6) for n in numbers])


@given(st.binary(max_size=300))
def test_noise_is_counted_and_says_nothing_impossible(noise):
    decoder = lines()
    rates = decoder.feed(noise)
    assert all(rate is None or abs(rate) <= radians(MAX_RATE) for rate in rates)
    decoder.feed(b"\r\n")
    assert decoder.feed(b"-2.000000 1\r\n") == [radians(-2.0)]


@pytest.mark.parametrize("decoder", [Lines(), lines()], ids=["first", "later"])
def test_noise_without_an_end_is_counted_and_not_kept(decoder):
    for _ in range(1000):
        assert decoder.feed(b"\x7f" * 10) == []
    assert decoder.counts == (0, 0, 10_000 // 70)
    assert len(decoder._rest) < 70
    assert decoder.feed(b"9.000000 1\r\n1.000000 1\r\n") == [radians(1.0)]
