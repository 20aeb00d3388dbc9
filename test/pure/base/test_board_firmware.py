"""The firmware of the base's board on this computer, under sanitizers, beside its Python table."""

import random
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest
from base_board import BOOT, GO, KEY, QUIET, SECOND, STOP, opens
from base_firmware import FirmwareBoard, board_core
from firmware import Core, needs_arm, needs_emulator

from fss_base_driver.protocol import (
    NO_ON_TIMES,
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
    encode,
)

MS = 1000
TIGHT = Limits(longest=200_000, allowance=150_000, duty=30, total=500_000)
MAX_ON_TIMES = VALVES * (0xFFFF,)


@pytest.fixture(scope="module")
def core() -> Iterator[Core]:
    core = board_core()
    yield core
    core.close()


@pytest.fixture
def board(core) -> FirmwareBoard:
    """A board at one second."""
    board = FirmwareBoard(core)
    board.run(SECOND)
    return board


# --- beside the table of states ------------------------------------------------------------------


def clumsy(rng, clock, sequence, number):
    """A command as a computer in trouble may send it: repeated, late, of another start."""
    flags = rng.choice([0, 0, BaseCommandFlag.STOP, *30 * [BaseCommandFlag.ARM]])
    command = replace(
        QUIET, flags=flags, sequence=sequence + rng.choice([1, 1, 1, 1, 1, 1, 0, -1, 5]),
        clock=clock + rng.randint(-1000, 0), boot=rng.choice([*12 * [BOOT], BOOT + 1]),
        watchdog=rng.choice([100, 500]),
    )  # fmt: skip
    if flags != BaseCommandFlag.ARM:
        return command
    times = tuple(rng.choice([0, 0, 1, 77, 300, 2500, 0xFFFF]) for _ in range(VALVES))
    pulse = (number + rng.choice([0, 0, 1, 1, 1, -1])) & 0xFFFF
    return replace(
        command,
        pulse=pulse,
        on_times=times if pulse else NO_ON_TIMES,
        gripper=rng.choice([0, 0, 1, 2]),
        expiry=clock + rng.randint(-10_000, 400_000),
    )


def same_as(board, table, measured):
    """Check that both know the same now; return what is seen."""
    table.tick(board.clock)
    seen = board.valves()
    wanted = (table.valves(), table.flags(), table.pulse, table.left, tuple(table.opened))
    assert seen == wanted
    for frame in measured:
        expected = table.telemetry(frame.clock, frame.sequence, Measured())
        for name in ("flags", "echo", "turnaround", "valves", "pulse", "pulse_age"):
            assert getattr(frame, name) == getattr(expected, name), name
        told = GripperFlag.COMMANDED_CLOSED
        assert frame.gripper & told == expected.gripper & told
        if frame.slow_id >= BaseSlow.LEFT or frame.slow_id == BaseSlow.REFUSED:
            assert (frame.slow_id, frame.slow_value) == (expected.slow_id, expected.slow_value)
    return seen


@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize("seed", range(3))
def test_it_does_what_the_table_says_to_the_microsecond(core, seed, key):
    limits = TIGHT if seed % 3 else Limits()
    board = FirmwareBoard(core, key=key, limits=limits)
    board.run(SECOND)
    table = BoardState(board_gate(BOOT, key), limits)
    rng, sequence, seen, opened = random.Random(seed), 100, set(), 0
    for _ in range(400):
        command = clumsy(rng, board.clock, sequence, table.pulse)
        taken = board.send(command)
        assert table.receive(encode(command, key), board.clock) == taken
        sequence = command.sequence if taken else sequence
        for _ in range(rng.randrange(1, 4)):
            pause = rng.choice([rng.randint(1, 1000), rng.randint(1, 60_000)])
            pause = rng.choice([*30 * [pause], 600_000])
            while pause > 0:  # no further than to the next frame, so that it is of now
                step = min(pause, 50_000 - board.clock % 50_000)
                frames = board.run(step)
                pause -= step
                known = same_as(board, table, frames)
                seen.add(known.flags)
                opened |= known.driven
    assert opened == 255
    assert {flag for flags in seen for flag in BaseState if flags & flag} >= {
        BaseState.ARMED,
        BaseState.STOPPED,
        BaseState.WATCHDOG,
        BaseState.LIMITED,
    }
    assert any(flags & BaseState.SPENT for flags in seen) == (limits is TIGHT)
    # What a table of time says is what the valves do, but for the step of the timer.
    real, known = board.opened(), board.valves().opened
    pulses = 800
    assert all(0 <= r - k <= 100 * pulses for r, k in zip(real, known, strict=True))


def test_a_datagram_that_is_too_long_is_refused(board):
    assert not board.send(encode(QUIET) + b"\0")
    assert board.send(QUIET)


# --- by itself -----------------------------------------------------------------------------------


#: What ends a pulse of all valves: changes of its command, when [us], flags after a second.
ENDINGS = [
    *(({"on_times": 8 * (n,)}, 100 * n, BaseState.ARMED) for n in (1, 77, 10_000)),
    ({"on_times": MAX_ON_TIMES}, SECOND, BaseState.ARMED | BaseState.LIMITED),
    *(({"watchdog": n}, MS * n, BaseState.WATCHDOG) for n in (100, 500)),
    ({"expiry": SECOND + 60 * MS}, 60 * MS, BaseState.ARMED),
]


@pytest.mark.parametrize("hangs", [False, True])
@pytest.mark.parametrize(("changes", "end", "flags"), ENDINGS)
def test_valves_close_by_themselves_though_the_loop_hangs(board, changes, end, flags, hangs):
    assert board.send(QUIET)
    assert board.send(opens(**{"on_times": 8 * (10_000,), "watchdog": 5000, **changes}))
    assert board.valves().driven == 255
    board.run(SECOND + 100, hangs)
    assert board.valves()[:2] == (0, flags)
    assert all(end <= opened <= end + 100 for opened in board.opened())  # a step of the timer


@pytest.mark.parametrize("hangs", [False, True])
def test_limits_hold_whatever_is_asked(core, hangs):
    """Commands for all valves for 20 s open each for its allowance and duty."""
    board = FirmwareBoard(core, limits=replace(TIGHT, total=100 * SECOND))
    assert board.send(QUIET)
    for k in range(200):
        asked = opens(MAX_ON_TIMES, 1 + k, 2 + k, expiry=board.clock + SECOND)
        assert board.send(replace(asked, watchdog=500))
        board.run(100 * MS, hangs)
    most = TIGHT.allowance + TIGHT.duty * board.clock // 100
    assert 0.97 * most < min(board.opened())
    assert max(board.valves().opened) <= most
    assert max(board.opened()) <= most + 200 * 100
    assert board.valves().flags == BaseState.ARMED | BaseState.LIMITED


# --- telemetry -----------------------------------------------------------------------------------


def test_it_measures_twenty_times_a_second_whatever_arrives(board):
    board.tell("flood 1000000")
    frames = board.run(2 * SECOND)
    assert len(frames) == 40
    assert {later.clock - frame.clock for frame, later in pairwise(frames)} == {50_000}
    assert {later.sequence - frame.sequence for frame, later in pairwise(frames)} == {1}
    slow = {BaseSlow(frame.slow_id): frame.slow_value for frame in frames}
    assert 0 < slow.pop(BaseSlow.REFUSED) <= 8 * 20_000  # at most eight each 0.1 ms
    assert slow == {
        BaseSlow.TANK: 20_000, BaseSlow.SUPPLY: 7000, BaseSlow.BATTERY: 148,
        BaseSlow.TEMPERATURE: 215, BaseSlow.FIRMWARE: 1 << 16,
        BaseSlow.FAULTS: 0, BaseSlow.LEFT: 300_000, **dict.fromkeys(range(9, 17), 0),
    }  # fmt: skip


def test_no_sample_of_the_gyro_is_lost_though_the_loop_hangs(board):
    board.tell("gyro -300 1")
    frames = board.run(5 * SECOND)
    board.run(SECOND, hangs=True)
    frames += board.run(50_000)
    for frame, later in [(frames[0], frames[1]), (frames[3], frames[-1])]:
        samples = (later.gyro_samples - frame.gyro_samples) & 0xFFFF
        total = (later.gyro_sum - frame.gyro_sum + (1 << 31)) % (1 << 32) - (1 << 31)
        assert samples == (later.clock - frame.clock) // 1000
        assert total == -300 * samples
    board.tell("gyro 5 0")  # it does not answer
    frames = board.run(SECOND)
    assert frames[-1].gyro_samples == frames[0].gyro_samples


LINES = [
    ("  0.000000 1\r\n", "0"),
    (" -0.012345 1\r\n  375.000000 1\r\n", "-1234 37500000"),
    ("  0.100000 0\r\n", "-"),  # it says that it is not valid
    ("0.100000\n1\n\n 1\n- 1\n.500000 1\n1.2.3 1\n--1.000000 1\n-.\n0.100000 1x\n", "-"),
    ("2 1\n0.12345 1\n0.1234567 1\n376.000000 1\n" + 40 * "9" + ".000000 1\n", "-"),
    ("0.1 x1\nDSP-3000\n0.500000 1\n", "50000"),
    ("", "-"),
]


@pytest.mark.parametrize(("text", "counts"), LINES)
def test_lines_of_a_serial_gyro(core, text, counts):
    before = "2.500000 1\n"  # may be the end of a line whose beginning was lost
    assert core.ask(f"gyro_lines {(before + text).encode().hex()}") == counts


def test_a_wire_that_is_cut_or_shorted_is_told(board):
    board.tell("fail 0 0 1 128")
    assert board.send(QUIET)
    assert board.send(opens((1000, 1000, *6 * (0,))))
    frames = board.run(SECOND)  # of which the pulse is long over
    (faults,) = {frame.slow_value for frame in frames if frame.slow_id == BaseSlow.FAULTS}
    assert faults == 1 | 1 << 15
    board.tell("fail 0 0 0 0")
    board.run(SECOND)
    frames = board.run(SECOND)
    (faults,) = {frame.slow_value for frame in frames if frame.slow_id == BaseSlow.FAULTS}
    assert faults == 1  # until valve 1 is driven again


def test_the_gripper_takes_its_time_and_is_not_opened_by_a_stop(board):
    board.tell("hold 1")
    assert board.send(QUIET)
    assert board.send(opens(gripper=Gripper.CLOSE))
    assert board.run(100 * MS)[-1].gripper == GripperFlag.COMMANDED_CLOSED
    assert board.send(replace(STOP, sequence=3))
    closed = GripperFlag.COMMANDED_CLOSED | GripperFlag.CLOSED | GripperFlag.HOLDS
    assert board.run(400 * MS)[-1].gripper == closed
    assert board.send(opens(gripper=Gripper.OPEN, sequence=4))
    assert board.run(400 * MS)[-1].gripper & GripperFlag.COMMANDED_CLOSED


# --- on the Due's processor ----------------------------------------------------------------------


def life(core):
    """Output of a board while it is armed, flown, left alone, and flown again."""
    board = FirmwareBoard(core, key=KEY, limits=TIGHT)
    said = [board.run(SECOND), board.send(replace(QUIET, clock=5))]
    for k in range(12):
        command = replace(GO, pulse=1 + k // 2, sequence=2 + k, clock=6 + k)
        said += [board.send(command), board.run(50_000 + 37 * k), board.valves()]
    return [*said, board.run(700 * MS, hangs=True), board.run(SECOND), board.opened()]


@needs_arm
@needs_emulator
@pytest.mark.slow
def test_a_cortex_m3_agrees_with_this_computer(core):
    emulated = board_core(cortex_m3=True)
    assert life(emulated) == life(core)
    emulated.close()
