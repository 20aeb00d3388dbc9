"""Behavior of the base's board: table of states, limits, exact times."""

import random
from dataclasses import replace

import pytest
from base_board import BOOT, GO, KEY, QUIET, SECOND, STOP, board, numbered, opens
from firmware_vectors import damaged
from hypothesis import given
from hypothesis import strategies as st

from fss_base_driver.protocol import (
    VALVES,
    BaseCommandFlag,
    BaseSlow,
    BaseState,
    BoardState,
    Gripper,
    GripperFlag,
    Limits,
    Measured,
    board_gate,
    decode,
    encode,
)

MS = 1000
ARM = replace(GO, pulse=0, on_times=VALVES * (0,), expiry=1 << 63)
MAX_ON_TIMES = VALVES * (0xFFFF,)


def send_command(state, command, clock=SECOND):
    return state.receive(encode(command), clock)


def test_it_starts_disarmed_and_closed():
    state = board()
    state.tick(10 * SECOND)
    assert (state.armed, state.valves(), state.flags()) == (False, 0, 0)


def test_a_pulse_opens_each_valve_for_its_time():
    state = board(QUIET, GO)
    assert state.armed
    for ms, valves in ((0, 3), (99.999, 3), (100, 2), (199.999, 2), (200, 0)):
        state.tick(SECOND + round(MS * ms))
        assert state.valves() == valves
    assert state.opened == [100 * MS, 200 * MS, *6 * [0]]
    assert state.left == Limits().total - 300 * MS


#: What comes after QUIET, at 1.05 s, while the pulse of GO (valves 1 and 2) is open; then armed,
#: flags and valves.
AFTER = [
    ("stop", [STOP], BaseState.STOPPED, 0),
    ("disarm", [QUIET], 0, 0),
    ("arm after stop", [STOP, opens(MAX_ON_TIMES, 2)], BaseState.STOPPED, 0),
    ("the way back", [STOP, QUIET, opens((50,) * 8, 2)], BaseState.ARMED, 255),
    ("another pulse", [opens((0, 0, 30, *5 * (0,)), 2)], BaseState.ARMED, 4),
    ("an older number", [opens((0, 0, 30, *5 * (0,)), 65535)], BaseState.ARMED, 4),
    ("the same number", [opens((0, 0, 30, *5 * (0,)), 1)], BaseState.ARMED, 3),
    ("no pulse", [ARM], BaseState.ARMED, 0),
    ("a pulse does not come back", [ARM, opens(MAX_ON_TIMES, 1)], BaseState.ARMED, 0),
    ("nor after arming again", [QUIET, opens(MAX_ON_TIMES, 1)], BaseState.ARMED, 0),
    ("an empty pulse", [opens(VALVES * (0,), 2)], BaseState.ARMED, 0),
]


@pytest.mark.parametrize(
    ("commands", "flags", "valves"), [row[1:] for row in AFTER], ids=[row[0] for row in AFTER]
)
def test_the_table(commands, flags, valves):
    state = board(QUIET, GO)
    for command in numbered(commands, 10):
        assert send_command(state, command, SECOND + 50 * MS)
    assert (state.flags(), state.valves()) == (flags, valves)
    assert state.armed == bool(flags & BaseState.ARMED)


def test_what_repeats_neither_lengthens_nor_shortens_a_pulse():
    state = board(QUIET, opens((1000, *7 * (0,))))
    for k in range(10):
        assert send_command(state, opens((1000, *7 * (0,)), 1, 3 + k), SECOND + 10 * MS * k)
        assert state.valves() == 1
    state.tick(SECOND + 100 * MS)
    assert state.valves() == 0


def test_a_command_that_expires_closes():
    state = board(QUIET, replace(GO, expiry=SECOND + 60 * MS))
    state.tick(SECOND + 60 * MS)
    assert state.valves() == 3
    state.tick(SECOND + 60 * MS + 1)
    assert state.valves() == 0
    assert state.armed
    assert state.flags() == BaseState.ARMED


def test_silence_closes_at_the_watchdog_however_late_it_is_asked():
    state = board(QUIET, opens(8 * (10_000,), watchdog=100))
    state.tick(5 * SECOND)
    assert state.flags() == BaseState.WATCHDOG
    assert state.opened == 8 * [100 * MS + 1]


@pytest.mark.parametrize("watchdog", [100, 500])
def test_silence_closes_and_disarms_within_the_watchdog(watchdog):
    state = board(QUIET, opens(8 * (10_000,), watchdog=watchdog))
    state.tick(SECOND + watchdog * MS)
    assert state.valves() == 255
    state.tick(SECOND + watchdog * MS + 1)
    assert (state.flags(), state.valves()) == (BaseState.WATCHDOG, 0)
    late = SECOND + 700 * MS
    assert not send_command(state, opens(MAX_ON_TIMES, 2, 3), late)  # a session cannot begin armed
    assert send_command(state, replace(QUIET, sequence=1), late)
    assert send_command(state, opens(MAX_ON_TIMES, 2, 2), late)
    assert state.valves() == 255


def test_a_pulse_longer_than_the_longest_is_cut():
    assert board(QUIET, opens((10_000, *7 * (0,)))).flags() == BaseState.ARMED  # it fits
    state = board(QUIET, opens((10_001, 10_000, *6 * (0,)), watchdog=5000))
    assert state.flags() == BaseState.ARMED | BaseState.LIMITED
    state.tick(2 * SECOND - 1)
    assert state.valves() == 3
    state.tick(2 * SECOND)
    assert state.valves() == 0
    assert send_command(state, replace(QUIET, sequence=3), 2 * SECOND)
    assert state.flags() == 0


def test_a_valve_that_is_kept_open_is_held_to_its_duty():
    state = board(QUIET, limits=Limits(allowance=2_000_000, duty=25))
    clock, sequence = SECOND, 2
    while clock < 101 * SECOND:  # pulses of 100 ms, without a gap, of the first valve
        clock, sequence = clock + 100 * MS, sequence + 1
        assert send_command(state, opens((1000, *7 * (0,)), sequence, sequence), clock)
    # Full at the start, and a quarter of the time; a pulse that begins takes what there is.
    assert state.opened[0] == pytest.approx(2_000_000 + 25 * SECOND, rel=0.01)
    assert state.opened[0] <= 2_000_000 + 25 * SECOND
    assert state.flags() == BaseState.ARMED | BaseState.LIMITED
    assert state.opened[1:] == 7 * [0]


def test_a_valve_closed_by_its_allowance_stays_so_until_the_next_pulse():
    state = board(
        QUIET, opens((9000, 9000, *6 * (0,)), watchdog=2000), limits=Limits(allowance=100_000)
    )
    state.tick(SECOND + 200 * MS - 1)
    assert state.valves() == 3
    state.tick(SECOND + 200 * MS)  # it fills again with half of what is taken
    assert (state.valves(), state.flags()) == (0, BaseState.ARMED | BaseState.LIMITED)
    state.tick(SECOND + 800 * MS)
    assert state.valves() == 0
    assert state.opened[:2] == [200 * MS] * 2


def test_the_total_time_is_spent_once_and_given_back_by_an_order_to_disarm():
    state = board(QUIET, opens(8 * (5000,)), limits=Limits(total=1_000_000))
    state.tick(SECOND + 125 * MS - 1)
    assert state.valves() == 255
    state.tick(SECOND + 125 * MS)
    assert (state.armed, state.valves(), state.flags()) == (False, 0, BaseState.SPENT)
    assert send_command(state, opens(MAX_ON_TIMES, 2, 3), SECOND + 130 * MS)
    assert (state.armed, state.valves()) == (False, 0)
    assert send_command(state, replace(QUIET, sequence=4), SECOND + 140 * MS)
    assert send_command(state, opens(MAX_ON_TIMES, 2, 5), SECOND + 140 * MS)
    assert state.valves() == 255


GRIPS = [
    ([opens(gripper=2)], Gripper.CLOSE),
    ([opens(gripper=2), opens()], Gripper.CLOSE),
    ([opens(gripper=2), STOP], Gripper.CLOSE),
    ([opens(gripper=2), QUIET], Gripper.CLOSE),
    ([opens(gripper=2), opens(gripper=1)], Gripper.OPEN),
    ([opens(gripper=2), STOP, opens(gripper=1)], Gripper.CLOSE),
]


@pytest.mark.parametrize(("commands", "expected"), GRIPS)
def test_the_gripper_stays_as_it_is_but_for_an_order_that_arms(commands, expected):
    assert board(*numbered([QUIET, *commands])).gripper is expected


def test_telemetry_says_all():
    state = board(QUIET, replace(opens((10, 20, *6 * (0,)), 9), gripper=Gripper.CLOSE))
    measured = Measured(
        (1 << 32) + 5, (1 << 16) + 6, closed=True, holds=True, slow={BaseSlow.TANK: 19_500}
    )
    frame = state.telemetry(SECOND + 1500, 16, measured)
    assert decode(encode(frame)) == frame
    assert (frame.flags, frame.boot, frame.sequence, frame.clock) == (1, BOOT, 16, SECOND + 1500)
    assert (frame.echo, frame.turnaround) == (2, 1500)
    assert (frame.gyro_sum, frame.gyro_samples) == (5, 6)
    assert (frame.valves, frame.pulse, frame.pulse_age) == (2, 9, 15)
    assert frame.gripper == GripperFlag.COMMANDED_CLOSED | GripperFlag.CLOSED | GripperFlag.HOLDS
    assert (frame.slow_id, frame.slow_value) == (BaseSlow.TANK, 19_500)
    slow = [state.telemetry(SECOND + 3500, k, measured) for k in range(16)]
    values = {frame.slow_id: frame.slow_value for frame in slow}
    assert set(values) == set(BaseSlow)
    assert (values[BaseSlow.OPEN_1], values[BaseSlow.OPEN_2]) == (1, 2)
    assert values[BaseSlow.LEFT] == 299_997


def test_before_a_pulse_there_is_no_age():
    frame = board(QUIET).telemetry(SECOND, 0, Measured())
    assert (frame.pulse, frame.pulse_age) == (0, 0xFFFF)
    old = board(QUIET, GO).telemetry(SECOND + 6_553_600, 0, Measured())
    assert (old.pulse, old.pulse_age) == (1, 0xFFFF)


def order(flags, times, pulse, expiry):
    pulse = {"pulse": pulse, "on_times": times} if flags == BaseCommandFlag.ARM else {}
    return replace(QUIET, flags=flags, expiry=expiry, **pulse)


COMMANDS = st.builds(
    order, st.sampled_from([0, 1, 1, 1, 1, 2]),
    st.tuples(*8 * [st.sampled_from([0, 1, 77, 3000, 0xFFFF])]), st.integers(1, 3),
    st.sampled_from([10_000, 200_000, 10_000_000]),
)  # fmt: skip
HISTORY = st.lists(st.tuples(st.integers(0, 150_000), COMMANDS), max_size=25)
TIGHT = Limits(longest=200_000, allowance=150_000, duty=30, total=900_000)


def play(history, ticks=()):
    """Yield a board after each command of a history, asked at other times as well."""
    state, clock = board(QUIET, limits=TIGHT), SECOND
    for k, (after, command) in enumerate(history, 2):
        for tick in sorted(t for t in ticks if clock < t <= clock + after):
            state.tick(tick)
        clock += after
        expiry = clock + command.expiry if command.flags == BaseCommandFlag.ARM else 0
        state.receive(encode(replace(command, sequence=k, clock=k, expiry=expiry)), clock)
        yield state, clock


@given(HISTORY, st.lists(st.integers(SECOND, 4 * SECOND), max_size=40))
def test_how_often_it_is_asked_changes_nothing_and_no_limit_is_exceeded(history, ticks):
    since = 0
    for (state, clock), (asked, _) in zip(play(history), play(history, ticks), strict=True):
        known = [(s.valves(), s.flags(), s.opened, s.left) for s in (state, asked)]
        assert known[0] == known[1]
        disarmed = state.gate.arrival == clock and state.gate.command.flags == 0
        since = sum(state.opened) if disarmed else since
        assert state.armed or not state.valves()
        assert sum(state.opened) - since < TIGHT.total + VALVES
        most = TIGHT.allowance + TIGHT.duty / 100 * (clock - SECOND)
        assert max(state.opened) <= most + 1
        assert max(state.remaining()) <= TIGHT.longest


# --- whatever comes ------------------------------------------------------------------------------


def following(state, order, clock):
    """The order as the next of a driver whom the board has heard all the time."""
    gate = state.gate
    return replace(
        order,
        sequence=(gate._newest + 1) & 0xFFFFFFFF,
        clock=min(gate._latest + 1, (1 << 64) - 1),
        expiry=clock + 500_000 if order.flags else 0,
    )


@pytest.mark.parametrize("inputs", [10_000, pytest.param(5_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("key", [None, KEY])
def test_whatever_comes_no_valve_is_open_unarmed_and_nothing_is_raised(inputs, key):
    rng, clock, taken, seen = random.Random(7), SECOND, 0, set()
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
            data = damaged(rng, rng.choice(pool), key)
        armed, opened = state.armed, list(state.opened)
        took = state.receive(data, clock)
        taken += took
        seen.add(state.flags())
        assert state.armed or not state.valves()
        assert armed or state.opened == opened  # none was open in the time that has passed
        if took:
            frame = state.telemetry(clock, k, Measured())
            assert decode(encode(frame, key), key) == frame
    assert taken > inputs // 100
    assert len(seen) > 3
