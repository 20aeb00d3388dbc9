"""Links on a simulated drive: the firmware, under sanitizers, and the driver's own (`copley://`)."""

import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise

import pytest
from driver_drive import CopleyLink
from driver_frames import BOOT, DISARM, KEY, MOVE, SECOND, path_segments
from firmware import Core, FirmwareLink, needs_arm, needs_emulator

from fss_arm_driver.faults import FAULTS, Word
from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    VELOCITY_UNIT,
    LinkCommandFlag,
    Mode,
    Slow,
    State,
    decode,
    encode,
    evaluate,
)
from fss_arm_driver.protocol.path import PathFollower
from fss_arm_model.description import paper_arm
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.vehicle import Motion


@pytest.fixture(scope="module")
def core() -> Iterator[Core]:
    core = Core()
    yield core
    core.close()


# --- the link ------------------------------------------------------------------------------------


MILLISECOND = 1_000_000  # in nanoseconds
STAMP = 1 << 33  # of a computer when the clock of its link is 0; an echo has 32 bits [us]
TURN = replace(MOVE, mode=Mode.VELOCITY, set_point=-300_000, velocity=0)
PUSH = replace(MOVE, mode=Mode.CURRENT, set_point=20, velocity=0, acceleration=0)
HOME = replace(
    DISARM,
    flags=LinkCommandFlag.ARM | LinkCommandFlag.HOME,
    mode=Mode.POSITION,
    expiry=100 * SECOND,
)
LATCHES = State.ARMED | State.STOPPED | State.WATCHDOG
slow = partial(pytest.param, marks=pytest.mark.slow)


@pytest.fixture(params=[FirmwareLink, CopleyLink])
def kind(request) -> type[FirmwareLink]:
    return request.param


firmware_only = pytest.mark.parametrize("kind", [FirmwareLink], indirect=True)


@pytest.fixture
def link(core, kind) -> FirmwareLink:
    """A link whose drive is connected, at one second."""
    link = kind(core, serial=23)
    link.run(1.0)
    link.orders()
    return link


def moving(link, command=MOVE):
    """The link, one second into a command."""
    assert link.send(DISARM)
    assert link.send(command)
    link.run(1.0)
    assert abs(link.joint().velocity) > 20_000
    link.orders()
    return link


def test_it_finds_the_drive_and_starts_disarmed_and_off(core, kind):
    link = kind(core, serial=23)
    assert not link.send(MOVE)
    frames = link.run(2.0)
    assert link.orders() == ["s r0x90 115200"]
    assert (link.joint().baud, link.joint().mode) == (115200, Mode.OFF)
    assert all(frame.flags == State.REFERENCED and frame.mode == Mode.OFF for frame in frames)
    assert frames[0].clock < 600_000


def test_a_datagram_that_is_too_long_is_refused(link):
    assert not link.send(encode(DISARM) + b"\0")
    assert link.send(DISARM)


@firmware_only
def test_it_measures_five_times_a_second_whatever_arrives(link):
    link.tell("flood 1000000")
    frames = link.run(3.0)
    periods = [later.clock - frame.clock for frame, later in pairwise(frames)]
    assert len(frames) == 15
    assert all(abs(period - 200_000) < 15_000 for period in periods)
    assert {later.sequence - frame.sequence for frame, later in pairwise(frames)} == {1}
    slow = {Slow(frame.slow_id): frame.slow_value for frame in frames}
    assert 0 < slow.pop(Slow.REFUSED) <= 8 * 30_000  # at most eight each 0.1 ms
    assert slow == {
        Slow.FAULTS: 0,
        Slow.SUPPLY: 240,
        Slow.BATTERY: 148,
        Slow.TEMPERATURE: 31,
        Slow.FIRMWARE: 0x20100,
        Slow.HOMINGS: 1,
        Slow.PATH: 0,
        Slow.SERIAL: 23,
    }


@firmware_only
@pytest.mark.parametrize("counts", [0, 1, -1, 123_456, (1 << 23) - 1, -(1 << 23)])
def test_it_reads_the_torque_converter(link, counts):
    link.tell(f"torque {counts}")
    frame = link.frame()
    assert frame.torque == counts
    assert frame.torque_age <= 13


def test_a_move_is_what_the_drives_guide_says(link):
    assert link.send(DISARM)
    assert link.send(replace(MOVE, set_point=40_000))
    reached = link.run(1.9)[-1]
    assert link.orders() == [
        "s r0x24 21",
        "s r0xc8 0",
        "s r0xca 40000",
        "s r0xcb 381972",
        "s r0xcc 7639",
        "s r0xcd 7639",
        "t 1",
    ]
    assert (link.joint().position, reached.position) == (40_000, 40_000)
    assert reached.mode == Mode.POSITION


@pytest.mark.parametrize(
    ("command", "orders"),
    [
        (TURN, ["s r0x36 76", "s r0x37 76", "s r0x2f -300000", "s r0x24 11"]),
        (PUSH, ["s r0x02 20", "s r0x24 1"]),
    ],
)
def test_set_points_are_written_before_the_mode_that_follows_them(link, command, orders):
    assert link.send(DISARM)
    assert link.send(command)
    frame = link.run(1.0)[-1]
    assert link.orders() == orders
    assert frame.mode == command.mode
    assert frame.velocity * command.set_point > 0


def test_a_command_repeated_is_the_same_move(link):
    moving(link)
    for sequence in range(3, 8):
        assert link.send(replace(MOVE, sequence=sequence))
        link.run(0.2)
    assert link.orders() == []


def test_set_points_faster_than_the_line_do_not_keep_it_from_measuring(link):
    moving(link, TURN)
    frames = []
    for sequence in range(3, 503):
        assert link.send(replace(TURN, sequence=sequence, set_point=-300_000 - 10 * sequence))
        frames += link.run(0.002)
    assert len(frames) == 5
    assert frames[-1].velocity < -304_000
    link.run(0.1)
    assert link.joint().velocity == pytest.approx(-30_502)


def test_a_new_target_is_taken_in_motion_and_another_mode_from_rest(link):
    moving(link)
    assert link.send(replace(MOVE, sequence=3, set_point=300_000))
    link.run(0.1)
    assert link.orders()[-1] == "t 1"
    assert link.joint().velocity > 20_000
    assert link.send(replace(TURN, sequence=4))
    link.run(1.0)
    assert link.orders() == ["t 0", "s r0x36 76", "s r0x37 76", "s r0x2f -300000", "s r0x24 11"]
    assert link.joint().velocity < -20_000


@pytest.mark.parametrize("command", [MOVE, TURN, PUSH])
def test_silence_trips_the_watchdog_and_only_a_disarming_frame_resets_it(link, command):
    moving(link, command)
    link.run(0.99)
    assert link.frame().flags & LATCHES == State.WATCHDOG  # two seconds have passed
    link.run(0.8)
    still = link.joint()
    assert (still.velocity, still.mode) == (0, Mode.POSITION)
    assert not link.send(replace(MOVE, sequence=3))
    assert link.send(replace(DISARM, sequence=4))
    assert link.send(replace(MOVE, sequence=5))
    assert link.frame().flags & LATCHES == State.ARMED


@pytest.mark.parametrize("command", [MOVE, TURN, PUSH])
def test_an_expired_set_point_is_held_and_the_link_stays_armed(link, command):
    moving(link, replace(command, expiry=2_100_000))
    link.run(0.9)
    assert link.send(replace(command, sequence=3, expiry=2_950_000))
    frame = link.run(1.0)[-1]
    assert frame.flags & LATCHES == State.ARMED
    assert link.joint().velocity == 0
    assert frame.mode == Mode.POSITION


@pytest.mark.parametrize(
    ("command", "braking", "holding"),
    [
        (MOVE, ["t 0"], []),
        (TURN, ["s r0x37 300", "s r0x2f 0"], ["s r0x24 21"]),
        (PUSH, ["s r0x37 300", "s r0x2f 0", "s r0x24 11"], ["s r0x24 21"]),
    ],
)
def test_stop_brakes_at_once_and_latches(link, command, braking, holding):
    if command is TURN and isinstance(link, CopleyLink):
        braking = [*braking, "s r0x24 11"]  # it repeats the mode
    moving(link, command)
    assert link.send(replace(DISARM, sequence=0, boot=BOOT + 5, flags=LinkCommandFlag.STOP))
    link.run(0.02)  # a reading under way, then three orders
    assert link.orders() == braking
    link.run(1.0)
    assert link.orders() == holding
    assert link.joint().velocity == 0
    assert link.send(replace(MOVE, sequence=4))
    assert link.frame().flags & LATCHES == State.STOPPED
    assert link.joint().velocity == 0
    assert link.send(replace(DISARM, sequence=5))
    assert link.send(replace(MOVE, sequence=6))
    assert link.frame().flags & LATCHES == State.ARMED


def test_a_stop_switches_nothing_on(link):
    link.run(1.0)
    assert link.send(DISARM)
    assert link.send(replace(DISARM, sequence=2, flags=LinkCommandFlag.STOP))
    frame = link.run(1.0)[-1]
    assert (frame.mode, frame.flags & LATCHES) == (Mode.OFF, State.STOPPED)
    assert link.joint().mode == Mode.OFF


@pytest.mark.parametrize("command", [MOVE, TURN, PUSH])
def test_stop_is_obeyed_whatever_exchange_is_under_way(core, command):
    for moment in range(0, 60, 4):
        link = FirmwareLink(core)
        link.run(1.0)
        assert link.send(DISARM)
        assert link.send(command)
        link.run(0.0004 * moment)
        assert link.send(replace(DISARM, sequence=3, flags=LinkCommandFlag.STOP))
        link.run(0.5)
        assert link.joint().velocity == 0
        assert link.joint().mode == Mode.POSITION


def velocity_when_off(link):
    """Run until the drive is off; return the velocity of its joint."""
    end = link.clock + SECOND
    while link.joint().mode != Mode.OFF:
        assert link.clock < end
        link.run(0.001)
    return link.joint().velocity


@pytest.mark.parametrize("command", [MOVE, TURN, PUSH])
def test_disarming_brakes_and_switches_off_at_rest(link, command):
    moving(link, command)
    assert link.send(replace(DISARM, sequence=3))
    assert velocity_when_off(link) == 0
    frame = link.run(1.0)[-1]
    assert (frame.mode, frame.flags & LATCHES) == (Mode.OFF, 0)


def test_a_joint_that_has_just_started_is_switched_off_only_at_rest(link):
    """A measurement from before it started says nothing about rest."""
    assert link.send(DISARM)
    assert link.send(replace(TURN, acceleration=100 * TURN.acceleration))
    link.run(0.015)
    assert link.send(replace(DISARM, sequence=3))
    assert velocity_when_off(link) == 0


@pytest.mark.parametrize("command", [MOVE, TURN, PUSH])
def test_a_joint_that_does_not_come_to_rest_is_switched_off_in_bounded_time(link, command):
    moving(link, command)
    link.tell("shake 1")
    assert link.send(replace(DISARM, sequence=3))
    link.run(2.9)
    assert link.joint().mode != Mode.OFF
    link.run(0.2)
    assert link.joint().mode == Mode.OFF


# --- the link against the simulator's ------------------------------------------------------------


def clumsy_command(rng, clock, sequence):
    """A command as a computer in trouble may send it: doubled, late, for another start or link."""
    flags = rng.choice(
        [LinkCommandFlag.ARM] * 8
        + [LinkCommandFlag.ARM | LinkCommandFlag.HOLD] * 3
        + [0, 0, 0, LinkCommandFlag.STOP]
    )
    return replace(
        rng.choice([MOVE, TURN, PUSH]),
        sequence=(sequence + rng.choice([-1, 0, 1, 1, 1, 1, 1, 2])) & 0xFFFFFFFF,
        flags=flags,
        link=rng.choice([2] * 20 + [3]),
        clock=STAMP + clock + rng.randint(-100_000, 0),
        boot=rng.choice([BOOT] * 9 + [BOOT + 1]),
        watchdog=rng.choice([500, 2000]),
        expiry=clock + rng.randint(-50_000, 2 * SECOND),
        set_point=rng.randint(-100, 100),
    )


def clumsy_segment(rng, clock):
    """A segment as the same computer may send it, of a path that is not commanded."""
    knots = [(0, 0, 0), (1, 5, 0)]
    (segment,) = path(
        max(0, clock + rng.randint(-2 * SECOND, 2 * SECOND)), knots, rng.choice([1, 2, 3])
    )
    stamp = STAMP + clock + rng.randint(-200_000, 0)
    return replace(segment, boot=rng.choice([BOOT] * 9 + [BOOT + 1]), clock=stamp)


@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize("seed", [0, *map(slow, (1, 2, 3))])
def test_it_takes_arms_and_trips_as_the_simulated_link_does(core, seed, key):
    link = FirmwareLink(core, key=key)
    link.run(0.999)  # so that nothing is taken at the very time of a measurement
    simulated = LinkElectronics(2, paper_arm().links[1], BOOT, key=key)
    rest = Motion(q=0.0, qd=0.0, current=0.0, torque=0.0)
    rng, sequence, stamp, seen = random.Random(seed), 0, STAMP, set()
    for _ in range(200):
        command = clumsy_command(rng, link.clock, sequence)
        if rng.random() < 0.1:
            command = replace(command, clock=stamp)  # that of the last accepted one
        taken = link.send(command)
        assert simulated.receive(encode(command, key), link.clock) == taken
        sequence, stamp = (command.sequence, command.clock) if taken else (sequence, stamp)
        segment, refused = clumsy_segment(rng, link.clock), simulated.gate.refused.total()
        assert not simulated.receive(encode(segment, key), link.clock)
        kept = simulated.gate.refused.total() == refused
        assert link.send(segment) == kept
        seen.add(("kept", kept))
        for frame in link.run(rng.choice([0.05, 0.2, 0.2, 0.2, 0.4, 2.5])):
            simulated.demand(frame.clock, rest)
            expected = decode(simulated.telemetry(frame.clock, rest), key)
            assert frame.flags & LATCHES == expected.flags & LATCHES
            assert (frame.echo, frame.turnaround) == (expected.echo, expected.turnaround)
            seen.add(frame.flags & LATCHES)
        simulated.demand(link.clock, rest)
    assert seen >= {0, State.ARMED, State.STOPPED, State.WATCHDOG, ("kept", True), ("kept", False)}


# --- the drive's line ----------------------------------------------------------------------------

ERRORS = [1, 15, 48]  # the drive's; all are handled alike


@firmware_only
@pytest.mark.parametrize("code", ERRORS)
def test_what_the_drive_refuses_is_held_instead_until_commanded_again(link, code):
    moving(link)
    link.tell(f"fail {code}")
    assert link.send(replace(MOVE, sequence=3, set_point=300_000))
    link.run(0.5)
    assert link.orders()[-1] == "t 0"
    assert link.joint().velocity == 0
    assert link.send(replace(MOVE, sequence=4, set_point=300_000))
    link.run(0.5)
    assert link.joint().velocity > 20_000


def test_what_the_drive_refused_before_a_stop_does_not_count_against_the_stop(core):
    outcomes = set()
    for moment in range(0, 50, 2):
        link = FirmwareLink(core)
        link.run(1.0)
        moving(link)
        link.tell("fail 15")
        assert link.send(replace(MOVE, sequence=3, set_point=300_000))
        link.run(0.0004 * moment)
        assert link.send(replace(DISARM, sequence=4, flags=LinkCommandFlag.STOP))
        link.run(0.5)
        held = link.joint().mode == Mode.POSITION
        assert held == ("s r0xc8 0" in link.orders())  # else it was the stop that was refused
        outcomes.add(held)
    assert outcomes == {True, False}


def test_a_drive_that_cannot_hold_is_switched_off(link):
    moving(link)
    link.tell("fail 15")
    assert link.send(replace(DISARM, sequence=3, flags=LinkCommandFlag.STOP))
    link.run(0.5)
    assert link.orders() == ["t 0", "s r0x24 0"]
    assert link.joint().mode == Mode.OFF
    assert set(modes(link, LinkCommandFlag.STOP, 1.0)) == {Mode.OFF}


SLOW_VARIABLES = {
    Slow.FAULTS: 0xA4,
    Slow.SUPPLY: 0x1E,
    Slow.TEMPERATURE: 0x20,
    "deceleration": 0xCF,
}


@firmware_only
@pytest.mark.parametrize("lacking", SLOW_VARIABLES)
def test_what_a_drive_lacks_is_not_taken_from_another_variable(link, lacking):
    link.tell(f"lack {SLOW_VARIABLES[lacking]}")
    slow = {frame.slow_id: frame.slow_value for frame in link.run(3.0)}
    expected = {Slow.FAULTS: 0, Slow.SUPPLY: 240, Slow.TEMPERATURE: 31} | {lacking: 0}
    assert {name: slow.get(name, 0) for name in expected} == expected
    moving(link, TURN)
    assert link.send(replace(DISARM, sequence=3))
    link.run(0.02)
    limit = [] if lacking == "deceleration" else ["s r0x37 300"]
    assert link.orders() == [*limit, "s r0x2f 0"]


def test_a_pulled_cable_disarms_and_says_nothing_stale(link):
    moving(link)
    link.tell("plug 0")
    before = link.run(1.0)
    assert all(frame.clock < 2_000_000 + 20_000 for frame in before)
    assert link.send(replace(DISARM, sequence=3, boot=0))
    link.tell("plug 1")
    after = link.run(3.0)
    assert after
    assert not any(frame.flags & LATCHES for frame in after)
    assert link.joint()[1:] == (0, Mode.OFF, 115200)


def test_a_cable_pulled_in_mid_line_is_survived(link):
    for cut in range(1, 60, 4):
        link.run(0.0001 * cut)
        link.tell("plug 0")
        link.run(0.0004)
        link.tell("plug 1")
        link.run(0.25)
    assert link.frame().status & 1 << 12


@firmware_only
def test_noise_on_the_line_is_survived_and_never_believed(link):
    rng = random.Random(3)
    moving(link)
    frames = []
    for sequence in range(3, 103):
        assert link.send(replace(MOVE, sequence=sequence, set_point=10_000_000))
        noise = rng.choice([b"ok\r", b"v 5\r", b"e 3\r", b"\r", rng.randbytes(30), b"v 99"])
        if sequence % 2:
            link.tell(f"noise {noise.hex()}")
        frames += link.run(0.2)
    assert len(frames) > 60
    assert not any({5, 99} & {frame.position, frame.velocity, frame.current} for frame in frames)
    assert all(frame.status in (1 << 27, 0) for frame in frames)


def test_a_power_cycle_is_survived_unreferenced_and_disarmed(link):
    moving(link)
    link.tell("power")
    frames = link.run(3.0)
    assert frames[-1].clock > 3_700_000
    assert not frames[-1].flags & (State.REFERENCED | State.ARMED)
    assert frames[-1].status & 1 << 20
    assert link.joint()[1:] == (0, Mode.OFF, 115200)
    link.tell("reference 1")
    homed = {frame.slow_id: frame for frame in link.run(2.0)}[Slow.HOMINGS]
    assert homed.flags & State.REFERENCED
    assert homed.slow_value == 2


def test_homing_is_begun_once_and_counted(link):
    assert link.send(DISARM)
    for sequence in range(2, 5):
        assert link.send(replace(HOME, sequence=sequence))
        frames = link.run(0.25)
        assert bool(frames[-1].flags & State.REFERENCED) == (sequence > 2)
    assert link.orders() == ["s r0x24 21", "t 2"]
    (homings,) = {f.slow_value for f in link.run(1.6) if f.slow_id == Slow.HOMINGS}
    assert homings == 2


def test_it_is_not_referenced_from_the_order_to_home_on(link):
    link.tell(f"lack {SLOW_VARIABLES['deceleration']}")
    moving(link, replace(TURN, acceleration=3000))
    assert link.send(replace(HOME, sequence=3, clock=99))
    frames = [frame for frame in link.run(3.0) if frame.echo == 99]
    referenced = [bool(frame.flags & State.REFERENCED) for frame in frames]
    assert not any(referenced[:3])  # while it brakes
    assert referenced == sorted(referenced)
    assert referenced[-1]


def test_a_drive_that_refuses_to_home_does_not_say_that_it_has(link):
    moving(link)
    link.tell("fail 15")
    assert link.send(replace(HOME, sequence=3, clock=99))
    frames = [frame for frame in link.run(1.0) if frame.echo == 99]
    assert frames
    assert not any(frame.flags & State.REFERENCED for frame in frames)
    assert link.send(
        replace(HOME, sequence=4, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOLD, mode=Mode.OFF)
    )
    assert link.frame().flags & State.REFERENCED


def modes(link, flags, seconds):
    """Repeat a command with these flags; the modes that the drive is in meanwhile."""
    seen = []
    for _ in range(round(seconds / 0.2)):
        link.send(replace(TURN, sequence=link.clock // 1000, flags=flags))
        link.run(0.2)
        seen.append(link.joint().mode)
    return seen


@pytest.mark.parametrize("goes_on", ["stop", "hold", "watchdog"])
@pytest.mark.parametrize(
    "happening",
    [("power",), (f"status {1 << 11}", "status 0"), (f"status {1 << 20}",), ("off",)],
    ids=["end of power", "blocked by the enable input", "reset bit", "by others"],
)
def test_nothing_switches_a_dropped_drive_on_again(link, happening, goes_on):
    held = LinkCommandFlag.ARM | LinkCommandFlag.HOLD
    flags = held if goes_on == "hold" else LinkCommandFlag.STOP
    moving(link)
    if goes_on == "watchdog":
        link.run(2.0)
    else:
        assert modes(link, flags, 1.0)[-1] == Mode.POSITION
    for told in happening:
        link.tell(told)
        modes(link, flags, 1.0)
    assert set(modes(link, flags, 3.0)) == {Mode.OFF}
    assert not link.frame().flags & State.ARMED
    assert link.send(replace(DISARM, sequence=link.clock // 1000))
    assert link.send(replace(TURN, sequence=link.clock // 1000 + 1))
    link.run(0.5)
    assert link.joint().mode == Mode.VELOCITY


@pytest.mark.parametrize("command", [MOVE, TURN, PUSH])
def test_its_own_restart_stops_a_moving_drive(link, command):
    moving(link, command)
    link.restart(BOOT + 1)
    frames = link.run(2.0)
    assert link.joint()[1:] == (0, Mode.OFF, 115200)
    assert frames[-1].boot == BOOT + 1
    assert not frames[-1].flags & LATCHES


def test_after_its_own_restart_it_brakes_with_the_drives_abort_deceleration(link):
    moving(link, TURN)
    assert link.send(replace(TURN, sequence=3, acceleration=100))  # would brake in half a minute
    link.run(0.2)
    assert link.orders() == ["s r0x36 1", "s r0x37 1", "s r0x2f -300000"]
    link.restart(BOOT + 1)
    link.run(1.0)
    repeated = ["s r0x24 11"] * isinstance(link, CopleyLink)
    assert link.orders() == ["s r0x90 115200", "s r0x37 300", "s r0x2f 0", *repeated, "s r0x24 0"]
    assert link.joint()[1:] == (0, Mode.OFF, 115200)


@firmware_only
@pytest.mark.parametrize("bit", [*range(20), *range(21, 32)])
def test_status_bits_disarm_as_the_fault_table_says(link, bit):
    blocks = {fault.bit: fault.blocks for fault in FAULTS if fault.word is Word.STATUS}
    moving(link)
    link.tell(f"status {1 << bit}")
    frame = link.run(0.5)[-1]
    assert frame.status >> bit & 1
    assert bool(frame.flags & State.ARMED) != blocks.get(bit, False)


def test_a_latched_fault_disarms_and_is_cleared_once_the_drive_is_off(link):
    moving(link)
    link.tell("faults 4")
    frame = link.run(1.0)[-1]
    assert not frame.flags & State.ARMED
    assert link.joint().mode == Mode.OFF
    assert not link.send(replace(MOVE, sequence=2))
    assert link.send(replace(MOVE, sequence=3))
    assert not link.frame().flags & State.ARMED  # while it lasts
    assert link.send(replace(DISARM, sequence=4, flags=LinkCommandFlag.CLEAR_FAULTS))
    link.run(0.5)
    assert link.orders()[-1] == "s r0xa4 4"
    assert link.send(replace(MOVE, sequence=5))
    assert link.frame().flags & State.ARMED


@pytest.mark.parametrize("plugged", [0, 1])
def test_faults_are_cleared_only_once_the_drive_is_off(link, plugged):
    """A drive that is still on would follow its last set-point again."""
    moving(link, TURN)
    link.tell("faults 4")
    link.run(0.1)
    assert abs(link.joint().velocity) > 1000
    link.tell(f"plug {plugged}")
    assert link.send(replace(DISARM, sequence=3, flags=LinkCommandFlag.CLEAR_FAULTS))
    link.run(1.0)
    link.tell("plug 1")
    link.run(2.0)
    assert link.orders()[-2:] == ["s r0x24 0", "s r0xa4 4"]


# --- paths ---------------------------------------------------------------------------------------

FOLLOW = replace(MOVE, mode=Mode.PATH, set_point=1, velocity=400_000, acceleration=7639)
DEGREE = 240_000 / 360  # [counts]
PATHS = State.FOLLOWING | State.BROKEN
#: Largest median and largest error on a path [deg], most set-points [1/s], and the time from the
#: start until the mode is read [us].
PATH_BOUNDS = {FirmwareLink: (0.005, 0.02, 100, 0), CopleyLink: (0.03, 0.1, 140, 100_000)}


def path(begin, knots, number=1):
    """The segments of a path: its knots' times [s] after `begin` [us], degrees and degrees/s."""
    knots = [
        (begin + round(1e6 * t), round(DEGREE * q), round(DEGREE * qd / VELOCITY_UNIT))
        for t, q, qd in knots
    ]
    return path_segments(knots, boot=BOOT, clock=9, path=number)


KNOTS = [(0, 0, 0), (2, 20, -2.5), (4, -10, 2.5), (6, 30, 6.25), (8, 15, -7.5), (10, 0, 0)]
SLOW_KNOTS = [(0.2 * i, 2.0 * i, 10.0 if 0 < i < 40 else 0.0) for i in range(41)]


def following(link, knots=KNOTS, seconds=1.0, kept=32):
    """Return a link some seconds into a path, and the segments that it has received."""
    segments = path(link.clock + 300_000, knots)
    assert link.send(replace(DISARM, clock=8))
    assert link.send(FOLLOW)
    assert all(link.send(segment) for segment in segments[:kept])
    link.run(0.3 + seconds)
    return segments


def angle(segments, clock):
    """Position of a path [counts]."""
    segment = next((s for s in segments if clock < s.end), segments[-1])
    return evaluate(segment, min(max(clock, segment.begin), segment.end))[0]


def track(link):
    """Follow KNOTS; errors [deg] each 10 ms to 0.5 s after the end, set-points/s, the rest."""
    assert link.send(DISARM)
    assert link.send(FOLLOW)
    segments = path(2 * SECOND, KNOTS)
    assert all(link.send(segment) for segment in reversed(segments))
    frames = link.run((segments[0].begin - link.clock) / SECOND)
    link.orders()
    errors, orders = [], []
    for step in range(1, 1051):
        frames += link.run(0.01)
        orders += link.orders() if link.clock <= segments[-1].end else []
        errors.append(abs(link.joint().position - angle(segments, link.clock)) / DEGREE)
        if step % 20 == 0:
            assert link.send(replace(FOLLOW, sequence=2 + step // 20))
    rate = sum(order.startswith("s r0x2f") for order in orders) / 10.0
    print(f"p50 {sorted(errors)[525]:.4f}, largest {max(errors):.4f} deg, {rate:.1f} set-points/s")
    return errors, rate, segments, frames


def test_a_path_is_followed_in_time(link):
    errors, rate, segments, frames = track(link)
    median, largest, fastest, delay = PATH_BOUNDS[type(link)]
    assert sorted(errors)[525] < median
    assert max(errors) < largest
    assert 80 < rate < fastest
    begin, end = segments[0].begin, segments[-1].end
    seen = [(frame.clock, frame.flags & PATHS, frame.mode) for frame in frames]
    assert {flags for clock, flags, _ in seen if clock < begin - 30_000} == {0}
    assert {f[1] for f in seen if begin < f[0] < end} == {State.FOLLOWING}
    assert {f[2] for f in seen if begin + delay < f[0] < end} == {Mode.VELOCITY}
    assert {f[1:] for f in seen if f[0] > end + 300_000} == {(0, Mode.VELOCITY)}


@firmware_only
@pytest.mark.parametrize("latency", [0.004, 0.008, 0.015])
def test_a_slow_drive_is_given_set_points_and_read_in_turns(link, latency):
    link.tell(f"delay {round(1e6 * latency)}")
    _, rate, _, frames = track(link)
    assert rate > (50 if latency < 0.01 else 25)
    assert len(frames) > 40  # in 11.5 s


def test_a_path_whose_segments_run_out_is_broken_and_does_not_come_back(link):
    segments = following(link, SLOW_KNOTS, seconds=1.2, kept=5)
    assert link.joint()[1:3] == (0, Mode.POSITION)
    link.orders()
    frame = link.frame()
    assert frame.flags & (PATHS | LATCHES) == State.BROKEN | State.ARMED
    assert not link.send(segments[8])
    assert link.send(replace(FOLLOW, sequence=3))
    assert link.frame().flags & PATHS == State.BROKEN
    assert link.orders() == []


def test_a_fault_ends_a_path(link):
    following(link, SLOW_KNOTS)
    link.tell("status 1")
    assert not link.run(0.5)[-1].flags & (State.ARMED | PATHS)
    assert link.joint()[1:3] == (0, Mode.OFF)


@firmware_only
@pytest.mark.parametrize("code", ERRORS)
def test_a_drive_that_refuses_a_set_point_breaks_the_path(link, code):
    following(link)
    link.tell(f"fail {code}")
    link.run(0.3)
    assert link.frame().flags & (PATHS | State.ARMED) == State.BROKEN | State.ARMED
    assert link.joint()[1:3] == (0, Mode.POSITION)


ENDINGS = {
    "disarmed": replace(DISARM, sequence=3),
    "stopped": replace(DISARM, sequence=3, flags=LinkCommandFlag.STOP),
    "held": replace(FOLLOW, sequence=3, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOLD),
    "turned": replace(TURN, sequence=3, set_point=10),
    "sent on an older path": replace(FOLLOW, sequence=3, set_point=0xFFFF),
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_path_is_gone_after(link, ending):
    segments = following(link, SLOW_KNOTS)
    later = path(link.clock + 5_000_000, [(0, 10, 0), (1, 15, 0)], number=2)
    assert link.send(later[0])
    assert link.send(ENDINGS[ending])
    frames = link.run(0.6)
    assert not any(frame.flags & PATHS for frame in frames[1:])
    kept = ending not in ("disarmed", "stopped")
    frames = link.run(0.8 if kept else 2.0)
    (report,) = {frame.slow_value for frame in frames if frame.slow_id == Slow.PATH}
    assert report == (2 << 16 | 1 if kept else 0)
    assert not link.send(segments[20])
    assert abs(link.joint().velocity) < 2


@pytest.mark.parametrize("silence", [False, True])
def test_a_path_is_gone_when_its_time_or_the_watchdogs_is_over(link, silence):
    expiry = 100 * SECOND if silence else link.clock + 2 * SECOND
    segments = path(link.clock + 100_000, SLOW_KNOTS)
    assert link.send(replace(DISARM, watchdog=2000 if silence else 3000))
    assert link.send(replace(FOLLOW, watchdog=2000 if silence else 3000, expiry=expiry))
    assert all(link.send(segment) for segment in segments[:30])
    link.run(1.9)
    assert link.joint().velocity > 1000
    link.run(0.4)
    assert link.joint().velocity == 0
    frame = link.frame()
    assert frame.flags & (PATHS | LATCHES) == (State.WATCHDOG if silence else State.ARMED)
    assert not link.send(segments[25])


def test_a_path_does_not_start_once_its_command_has_expired(link):
    assert link.send(DISARM)
    assert link.send(replace(FOLLOW, expiry=link.clock + 300_000))
    assert all(link.send(segment) for segment in path(link.clock + 500_000, KNOTS))
    frames = link.run(1.0)
    assert not any(frame.flags & PATHS for frame in frames)
    assert link.orders() == ["s r0x24 21"]


def test_segments_are_for_the_armed(link):
    segments = path(link.clock + 300_000, KNOTS)
    assert link.send(DISARM)
    assert not link.send(segments[0])
    assert link.send(FOLLOW)
    past, far = {"begin": 1, "duration": 1000}, {"begin": 200 * SECOND}
    for wrong in ({"link": 3}, {"boot": BOOT + 1}, past, far):
        assert not link.send(replace(segments[0], **wrong))
    link.run(0.1)
    assert link.orders()[-1] == "s r0x24 21"  # told of no path, it holds
    assert link.send(segments[0])


def test_no_segment_comes_after_a_last_one(link):
    segments = path(link.clock + 300_000, KNOTS)
    last = segments[-1]
    beyond = {"index": last.index + 1, "begin": last.end, "position": last.end_position}
    assert link.send(DISARM)
    assert link.send(FOLLOW)
    assert link.send(segments[2])
    assert not link.send(replace(segments[0], flags=LAST_SEGMENT, end_velocity=0))
    assert link.send(last)
    assert not link.send(replace(last, velocity=0, **beyond))


def test_a_segment_recorded_before_the_link_was_disarmed_is_refused(core):
    link = FirmwareLink(core, key=KEY)
    link.run(1.0)
    moving(link, replace(MOVE, clock=6))
    (segment,) = path(link.clock + 300_000, [(0, 0, 0), (1, 5, 0)])
    assert link.send(replace(DISARM, sequence=3, clock=9))
    link.run(0.1)
    assert link.send(replace(FOLLOW, sequence=4, clock=10))
    assert not link.send(encode(replace(segment, clock=10)))  # not signed
    assert not link.send(replace(segment, clock=9))
    assert link.send(replace(segment, clock=10))


def random_path(rng, begin, number):
    """The segments of a path whose knots join as a computer's do."""
    knots = [(begin, rng.randint(-1000, 1000), 0)]
    count = rng.choice([1, 3, 6, 40])
    for left in reversed(range(count)):
        t, p, v = knots[-1]
        duration = rng.choice([1000, 20_000, 200_000, rng.randint(1000, 1_000_000)])
        velocity = rng.randint(-20_000, 20_000) if left else 0
        knots.append((t + duration, p + round(1e-7 * duration * (v + velocity) / 2), velocity))
    return path_segments(knots, boot=BOOT, path=number)


def random_segment(rng, segments, clock):
    """Mostly one that is due; now and then with another field."""
    due = [segment for segment in segments if segment.end > clock][:4]
    segment = rng.choice([*due, *due, rng.choice(segments)])
    if rng.random() < 0.03:
        name = rng.choice(["index", "begin", "position", "velocity", "end_position"])
        value = max(0, getattr(segment, name) + rng.choice([-1, 1, 32]))
        segment = replace(segment, **{name: value})
    return segment


@pytest.mark.parametrize("seed", [*range(2), *map(slow, range(2, 20))])
def test_paths_are_kept_and_followed_as_the_simulated_link_does(core, seed):
    rng, clock, paths, answers = random.Random(seed), 10 * SECOND, PathFollower(), Counter()
    core.ask("paths")
    number, known = rng.choice([1, 40_000, 65_530]), {}
    for _ in range(2000):
        kind = rng.random()
        if kind < 0.5:
            one = (number + rng.choice([0, 0, 0, 0, 1, -1])) & 0xFFFF or 1
            begin = clock + rng.randint(-100_000, 500_000)
            segments = known.setdefault(one, random_path(rng, begin, one))
            segment = random_segment(rng, segments, clock)
            refused = paths.store(segment, clock)
            answer = core.ask(f"keep {encode(segment).hex()} {clock}")
            assert answer == ("refused" if refused else "taken"), refused
            answers[answer] += 1
        elif kind < 0.995:
            clock += rng.choice([0, 1000, 10_000, 10_000, 10_000, rng.randint(0, 100_000)])
            over = paths.broken or (number in known and clock > known[number][-1].end)
            number = (number + (rng.random() < (0.3 if over else 0.003))) & 0xFFFF or 1
            position = round(angle(known[number], clock)) if number in known else 0
            position += rng.choice([0, rng.randint(-1000, 1000)])
            velocity = rng.choice([0, 999, -1000])
            most = rng.choice([20_000, 100_000, 100_000, 300_000])
            order = replace(FOLLOW, set_point=number, velocity=most)
            lead = rng.choice([0, 8000])
            wanted = paths.follow(order, clock, position, VELOCITY_UNIT * velocity, lead)
            told = "hold" if wanted is None else str(round(wanted / VELOCITY_UNIT))
            flags = f"{paths.following:d} {paths.broken:d}"
            answer = core.ask(f"follow {number} {most} {clock} {lead} {position} {velocity}")
            assert answer == f"{told} {flags} {paths.report}"
            answers[flags] += 1
        else:
            core.ask("leave")
            paths.abandon()
    assert min(answers[key] for key in ("taken", "refused", "1 0", "0 1")) > 20, answers


# --- on the Due's processor ----------------------------------------------------------------------


@needs_arm
@needs_emulator
@pytest.mark.slow
def test_a_cortex_m3_agrees_with_this_computer(core):
    emulated = Core(cortex_m3=True)
    assert tracked(emulated) == tracked(core)
    emulated.close()


def tracked(core):
    link = FirmwareLink(core)
    link.run(1.0)
    return track(link)
