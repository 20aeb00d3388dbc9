"""Attacks on the board: recorded, forged, delayed or invented frames open no valve."""

import random
import time
from collections import Counter
from dataclasses import replace
from struct import pack_into
from zlib import crc32

import pytest
from base_board import BOOT, KEY, QUIET, SECOND, STOP, opens
from driver_frames import sealed

from fss_base_driver.protocol import (
    BaseState,
    BoardState,
    Measured,
    board_gate,
    decode,
    encode,
)
from fss_link.protocol import Refused

STEP = 50_000  # from one command to the next [us]


def session(key):
    """Commands of a driver, by the board's clock: arm, open, stop, arm again, open."""
    orders = [QUIET, QUIET, *(opens((400,) * 8, 1) for _ in range(6)), STOP, STOP, QUIET]
    orders += [opens((0,) * 8, 0, gripper=0) for _ in range(3)]
    orders += [opens((0, 200, *6 * (0,)), 2) for _ in range(4)]
    sent = []
    for k, order in enumerate(orders, 1):
        clock = SECOND + k * STEP
        expiry = clock + 500_000 if order.flags == 1 else 0
        order = replace(order, sequence=k, clock=10**15 + k, expiry=expiry)
        sent.append((clock, encode(order, key)))
    return sent


def live(key, attack=lambda state, clock, heard: None):
    """The valves' open times of a board that lives through the session, attacked in between."""
    state, heard = BoardState(board_gate(BOOT, key)), []
    for clock, data in session(key):
        attack(state, clock - 1, heard)
        assert state.receive(data, clock)
        heard.append(data)
        own = state.telemetry(clock, len(heard), Measured())
        heard.append(encode(own, key))
        attack(state, clock + 1, heard)
    last = clock
    for _ in range(40):
        last += STEP
        state.tick(last)
        attack(state, last, heard)
    return state, last


def replayed(state, clock, heard):
    for data in heard:
        state.receive(data, clock)


def reordered(state, clock, heard):
    for data in reversed(heard):
        state.receive(data, clock)


def forged(state, clock, heard):
    """Bytes of what was heard changed, the CRC put right, signed as well as can be."""
    for data in heard[-6:]:
        for at in (4, 5, 6, 8, 12, 20, 28, 32, 40, 48):
            made = bytearray(data)
            made[at] ^= 1
            pack_into("<I", made, 52, crc32(made[:52]))
            state.receive(bytes(made), clock)


def cut(state, clock, heard):
    for data in heard[-4:]:
        for made in (data[:-1], data + b"\0", data[:20], b"", data[::-1]):
            state.receive(made, clock)


def unsigned(state, clock, heard):
    """A command that would do, without the key, or under another."""
    order = opens((0xFFFF,) * 8, 77, sequence=0x7FFFFFF0)
    for key in (None, KEY[::-1]):
        state.receive(encode(order, key), clock)


def foreign(state, clock, heard):
    """Frames of the links, and frames for another start."""
    for data in heard[-4:]:
        made = bytearray(data)
        made[3] = 2
        pack_into("<I", made, 52, crc32(made[:52]))
        state.receive(bytes(made), clock)


SIGNED = [replayed, reordered, forged, cut, unsigned, foreign]


@pytest.mark.parametrize("attack", SIGNED)
def test_with_a_key_nothing_that_an_attacker_sends_changes_anything(attack):
    honest, _ = live(KEY)
    state, _ = live(KEY, attack)
    assert state.opened == honest.opened == [350_000 - 310_000, 60_000, *6 * [40_000]]
    assert state.flags() == honest.flags() == BaseState.WATCHDOG
    assert state.gate.refused.total() > 10
    assert not state.valves()


@pytest.mark.parametrize("attack", [replayed, reordered, cut, foreign])
def test_without_a_key_what_was_heard_and_what_is_damaged_opens_no_valve(attack):
    """But a stop that is played again stops: that is open to all."""
    honest, _ = live(None)
    state, _ = live(None, attack)
    assert all(got <= due for got, due in zip(state.opened, honest.opened, strict=True))
    assert state.gate.refused.total() > 10
    assert not state.valves()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, Refused.SEQUENCE),  # the same again
        ({"sequence": 5}, Refused.SEQUENCE),
        ({"sequence": 100, "boot": BOOT + 1}, Refused.BOOT),
        ({"sequence": 100, "expiry": SECOND}, Refused.EXPIRED),
        ({"sequence": 100, "clock": 1}, Refused.SEQUENCE),  # signed before
    ],
)
def test_each_refusal_is_counted_by_its_reason(change, reason):
    state, order = BoardState(board_gate(BOOT, KEY)), opens((0,) * 8, 1, 9, expiry=9 * SECOND)
    assert state.receive(encode(replace(QUIET, sequence=8, clock=8), KEY), 2 * SECOND)
    assert state.receive(encode(order, KEY), 2 * SECOND)
    late = replace(order, on_times=(999,) * 8, pulse=5, **({"clock": 50} if change else {}))
    assert not state.receive(encode(replace(late, **change), KEY), 2 * SECOND)
    assert state.gate.refused == {reason: 1}
    assert not state.valves()


def mutated(rng, pool, key):
    """Noise, a damaged frame, or one whose fields are anything, signed with the key."""
    kind = rng.random()
    if kind < 0.1:
        return rng.randbytes(rng.choice((0, 5, 71, 72, 72, 73, 200)))
    data = bytearray(rng.choice(pool))
    for _ in range(rng.randint(1, 3)):
        data[rng.randrange(72)] = rng.randrange(256)
    if kind < 0.3:
        return bytes(data)
    if kind < 0.5:
        data[4:52] = b"\0" + rng.randbytes(47)
    data[0:4] = b"\x53\x46\x02" + bytes([rng.choice((4, 5, 5, 5))])
    data[4] = 0
    return sealed(bytes(data), key)


def following(state, order, clock):
    """The order as the next of a driver whom the board has heard all the time."""
    gate = state.gate
    return replace(
        order,
        sequence=(gate._newest + 1) & 0xFFFFFFFF,
        clock=min(gate._latest + 1, (1 << 64) - 1),
        expiry=clock + 500_000 if order.flags else 0,
    )


@pytest.mark.parametrize("inputs", [60_000, pytest.param(5_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("key", [None, KEY])
def test_whatever_comes_no_valve_is_open_unarmed_and_nothing_is_raised(inputs, key, capsys):
    rng, clock, taken, seen, begun = random.Random(7), SECOND, 0, Counter(), time.time()
    for k in range(inputs):
        clock += rng.choice((0, 3, 100, 5000, 70_000))
        if k % 1000 == 0:  # one who has the key may have used up the order of stamps
            state = BoardState(board_gate(BOOT, key))
            pool = [encode(QUIET, key), encode(STOP, key)]
        if k % 50 < 2:  # the driver continues in between
            order = QUIET if k % 250 == 0 else opens([rng.randrange(3000)] * 8, k % 65535 + 1)
            data = encode(following(state, order, clock), key)
            pool = [*pool[-8:], data]
        else:
            data = mutated(rng, pool, key)
        armed, opened = state.armed, list(state.opened)
        took = state.receive(data, clock)
        taken += took
        seen[state.flags()] += 1
        assert state.armed or not state.valves()
        assert armed or state.opened == opened  # none was open in the time that has passed
        if took:
            frame = state.telemetry(clock, k, Measured())
            assert decode(encode(frame, key), key) == frame
    assert taken > inputs // 100
    assert len(seen) > 3
    if inputs > 100_000:
        with capsys.disabled():
            each = 1e6 * (time.time() - begun) / inputs
            print(f"\n  {inputs} inputs, {taken} taken, {each:.1f} us each: {dict(seen)}")
