"""The servo drive's own language, and a drive straight on the computer's serial port."""

import termios
import time
from dataclasses import replace

import pytest
from driver_drive import DriveOnPty, FakeDrive
from driver_wire import ENDS, go_in_mid_open

from fss_arm_driver.copley.drive import REPLY_TIME, Demand, Drive, Goal
from fss_arm_driver.copley.language import (
    ERRORS,
    Error,
    LineError,
    Ok,
    Value,
    Variable,
    parse,
)
from fss_arm_driver.copley.link import DriveLink
from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    State,
    at,
    decode,
    encode,
)
from fss_arm_driver.session import LinkSession
from fss_arm_driver.transport import open_transport
from fss_arm_model.description import paper_arm
from fss_link.session import Arming
from fss_link.transport import TransportError

SECOND = 1_000_000  # [us]
MEANT = (1, 3, 4, 5, 9, 10, 11, 14, 15, 16, 18, 19, 20, 21, 22, 25, 27, 31, 32, 33, 36, 46, 48)


# --- the language ---


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        (b"ok", Ok()),
        (b"v 0", Value(0)),
        (b"v 134217728", Value(1 << 27)),
        (b"v -40000", Value(-40000)),
        (b"v -2147483648", Value(-(1 << 31))),
        (b"v 4294967295", Value(0xFFFFFFFF)),
        (b"e 33", Error(33)),
    ],
)
def test_lines_of_the_drive_are_read(line, reply):
    assert parse(line) == reply


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"o",
        b"ok ",
        b"OK",
        b"v",
        b"v ",
        b"v x",
        b"v 1 2",
        b"v --1",
        b"v 4294967296",
        b"e -1",
        b"e",
        b"\xff\xfe",
        b"v 99999999999",
        b"\nok",
        "v ²".encode(),
    ],
)
def test_lines_that_no_drive_says_are_refused(line):
    with pytest.raises(LineError):
        parse(line)


def test_each_error_code_has_its_words():
    assert set(MEANT) <= ERRORS.keys()
    assert str(Error(18)) == "error 18: already moving"
    assert str(Error(99)) == "error 99: not in the guide"


# --- the drive ---


class Bench:
    """A drive's two sides at a line, in virtual time."""

    def __init__(self, baud=115_200):
        self.there, self.here = FakeDrive(), Drive(baud)
        self.now, self.cut = 0, False

    def run(self, seconds=0.5, until=lambda: False):
        end, answer = self.now + round(seconds * SECOND), b""
        while self.now < end and not until():
            self.now += 2000
            if self.now % 20_000 == 0:
                self.there.turn()
            line = self.here.poll(b"" if self.cut else answer, self.now)
            answer = b"" if self.cut else self.there.feed(line, self.here.baud)
        return self

    def commands(self, since=0):
        return [line for line in self.there.lines[since:] if line[:1] in ("s", "t")]

    def demand(self, goal, *values):
        before = len(self.there.lines)
        self.here.demand = Demand(goal, *values)
        self.run()
        return self.commands(before)


@pytest.fixture
def bench():
    bench = Bench()
    bench.run(2.0, lambda: bench.here.reading)
    return bench


def test_the_rate_is_raised_from_9600(bench):
    assert bench.there.lines[:3] == ["", "g r0xa0", "s r0x90 115200"]
    assert bench.there.baud == bench.here.baud == 115_200
    assert bench.here.reading.position == 0
    assert bench.here.referenced


def test_a_drive_left_at_the_fast_rate_is_found():
    bench = Bench()
    bench.there.baud = 115_200
    bench.run(2.0)
    assert bench.here.reading


def test_9600_may_be_kept():
    bench = Bench(9600).run(2.0)
    assert bench.here.reading
    assert not any("0x90" in line for line in bench.there.lines)


def test_a_position_is_reached_by_the_guides_words(bench):
    told = bench.demand(Goal.POSITION, 40000, 70000)
    assert told == ["s r0x24 21", "s r0xc8 0", "s r0xca 40000", "s r0xcb 70000", "t 1"]
    assert bench.here.reading.position == 40000
    told = bench.demand(Goal.POSITION, 0, 70000, 5000)
    assert told == [
        "s r0xc8 0",
        "s r0xca 0",
        "s r0xcb 70000",
        "s r0xcc 5000",
        "s r0xcd 5000",
        "t 1",
    ]
    assert bench.demand(Goal.POSITION, 0, 70000, 5000) == []


def test_each_mode_is_entered_from_rest_and_left_with_a_brake(bench):
    assert bench.demand(Goal.VELOCITY, 5000, 0, 200) == [
        "s r0x36 2",
        "s r0x37 2",
        "s r0x2f 5000",
        "s r0x24 11",
    ]
    assert bench.demand(Goal.VELOCITY, -6000) == ["s r0x2f -6000"]
    assert bench.demand(Goal.CURRENT, 50) == [
        "s r0x37 300",
        "s r0x2f 0",
        "s r0x24 11",
        "s r0x02 50",
        "s r0x24 1",
    ]
    assert bench.demand(Goal.HOLD) == ["s r0x37 300", "s r0x2f 0", "s r0x24 11", "s r0x24 21"]
    assert bench.demand(Goal.RELEASE) == ["t 0", "s r0x24 0"]
    assert bench.demand(Goal.HOLD) == ["s r0x24 21"]
    assert bench.demand(Goal.HOME) == ["t 2"]


@pytest.mark.parametrize("code", MEANT)
def test_whatever_is_refused_is_held_and_said(bench, code):
    bench.there.error = code
    bench.demand(Goal.POSITION, 40000, 70000)
    assert f"error {code}: {ERRORS[code]}" in bench.here.refusal
    assert bench.there.position == 0
    assert bench.here.reading.mode in (Mode.POSITION, Mode.OFF)
    bench.demand(Goal.RELEASE)
    assert bench.here.refusal == ""
    assert bench.there.held[0x24] == 0


def test_a_refused_order_ends_the_move_before(bench):
    bench.demand(Goal.POSITION, 40000, 70000)
    bench.there.moving, bench.there.error = 1000, 15  # a long move
    assert bench.demand(Goal.POSITION, 80000, 70000) == ["s r0xc8 0", "t 0"]
    assert (bench.there.held[0x24], bench.there.velocity) == (21, 0)
    assert "error 15" in bench.here.refusal


def test_a_demand_made_again_while_braking_is_followed(bench):
    bench.there.shakes = True
    bench.demand(Goal.POSITION, 40000, 70000)
    before = len(bench.there.lines)
    bench.here.demand = Demand(Goal.HOLD)
    bench.run(0.4)
    bench.here.demand = Demand(Goal.POSITION, 40000, 70000)
    bench.run(0.4)
    assert bench.commands(before)[-1] == "t 1"


@pytest.mark.parametrize("goal", [(Goal.POSITION, 40000, 70000), (Goal.CURRENT, 50)])
def test_a_joint_that_does_not_come_to_rest_is_switched_off_in_bounded_time(bench, goal):
    bench.demand(*goal)
    bench.there.shakes = True
    bench.here.demand = Demand()
    bench.run(2.9)
    assert bench.there.held[0x24] != 0
    bench.run(0.5)
    assert bench.there.held[0x24] == 0


def test_what_cannot_be_switched_on_stays_off(bench):
    bench.there.held[0xA4] = 1 << 9
    bench.run()
    assert bench.here.slow[Variable.FAULTS] == 1 << 9
    bench.here.clear_faults = True
    bench.run()
    assert bench.there.held[0xA4] == 0


@pytest.mark.parametrize("cut_at", range(12))
def test_a_cable_pulled_in_mid_line_costs_the_demand_and_not_the_drive(bench, cut_at):
    bench.here.demand = Demand(Goal.VELOCITY, 5000)
    for _ in range(cut_at):
        bench.run(0.002)
    bench.there.buffer = b"s r0x2"  # the start of a line
    bench.cut = True
    bench.run(2.0)
    assert bench.here.reading is None
    bench.here.demand = Demand()
    bench.cut = False
    bench.run(4.0)
    assert bench.here.reading
    assert bench.there.held[0x24] == 0
    assert bench.there.velocity == 0


def test_noise_in_an_answer_is_asked_again(bench):
    bench.here.poll(b"v 1\xff7\r", bench.now)
    assert bench.run(0.6).here.reading


def test_a_silent_drive_is_lost_in_time(bench):
    bench.there.mute = True
    bench.run(1.0, lambda: bench.here.reading is None)
    assert bench.here.reading is None
    assert bench.now < 4 * REPLY_TIME + SECOND


def test_power_that_came_back_shows_as_reset_and_unreferenced(bench):
    bench.demand(Goal.POSITION, 40000, 70000)
    bench.there.switch_on()
    bench.here.demand = Demand()
    bench.run(4.0)
    assert bench.here.reading.status & 1 << 20
    assert not bench.here.referenced
    bench.demand(Goal.HOME)
    assert bench.here.referenced
    assert bench.here.homings == 2


# --- as a link ---


def command(link, clock, **fields):
    first = link.state.gate.command
    frame = Command(
        link=1, flags=0, boot=7, sequence=first.sequence + 1 if first else 1, clock=clock,
        expiry=clock + SECOND, mode=Mode.OFF, watchdog=2000, set_point=0, velocity=0,
        acceleration=0,
    )  # fmt: skip
    link.receive(encode(replace(frame, **fields)), clock)


class LinkBench:
    """A drive as a link, in virtual time."""

    def __init__(self):
        self.there, self.link = FakeDrive(), DriveLink(1, 7, None, 115_200)
        self.now, self.frames, self.answer = 0, [], b""

    def run(self, seconds):
        end = self.now + round(seconds * SECOND)
        while self.now < end:
            self.now += 2000
            if self.now % 20_000 == 0:
                self.there.turn()
            line, frame = self.link.poll(self.answer, self.now)
            self.answer = self.there.feed(line, self.link.drive.baud)
            if frame:
                self.frames.append(decode(frame))

    def arm(self, **fields):
        command(self.link, self.now)
        self.run(0.1)
        command(self.link, self.now, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOLD)
        self.run(0.3)
        command(self.link, self.now, flags=LinkCommandFlag.ARM, **fields)


def test_telemetry_comes_at_its_rate_and_says_what_there_is():
    bench = LinkBench()
    bench.run(3.0)
    assert 11 <= len(bench.frames) <= 15
    frame = bench.frames[-1]
    assert frame.flags == State.REFERENCED
    assert frame.torque_age == 255
    assert {frame.slow_id for frame in bench.frames} == {1, 2, 4, 6, 7, 8, 9}


def test_armed_it_moves_and_holds_when_its_time_is_over():
    bench = LinkBench()
    bench.run(1.0)
    bench.arm(mode=Mode.POSITION, set_point=40000, velocity=70000)
    bench.run(0.8)
    assert bench.frames[-1].position == 40000
    assert bench.frames[-1].flags & State.ARMED
    bench.arm(mode=Mode.VELOCITY, set_point=5000)
    bench.run(0.8)
    assert bench.there.velocity == 5000
    bench.run(0.8)
    assert bench.there.held[0x24] == 21
    assert bench.there.velocity == 0


PIECES = [
    Segment(
        link=1,
        flags=LAST_SEGMENT * (k == 1),
        boot=7,
        sequence=k,
        clock=1,
        path=4,
        index=k,
        begin=(3 + k) * SECOND,
        duration=SECOND,
        position=40_000 * k,
        velocity=0,
        end_position=40_000 * (1 - k),
        end_velocity=0,
    )
    for k in range(2)
]


def following():
    """At 2.5 s; path 4 begins at 3 s, goes to 40000 counts within 1 s, and back."""
    bench = LinkBench()
    bench.run(1.0)
    forever = {"expiry": 100 * SECOND, "watchdog": 60_000}
    bench.arm(mode=Mode.PATH, set_point=4, velocity=700_000, acceleration=100_000, **forever)
    for piece in PIECES:
        bench.link.receive(encode(piece), bench.now)
    bench.run(2.5 - 1e-6 * bench.now)
    assert bench.there.held[0x24] == 21  # it holds
    return bench


def test_a_path_is_followed_at_50_hz_or_more():
    bench = following()
    bench.run(0.7)
    begin, off, said = bench.now, [], len(bench.there.lines)
    for _ in range(180):
        bench.run(0.01)
        piece = PIECES[bench.now >= PIECES[1].begin]
        if bench.now < PIECES[1].end:
            off.append(abs(bench.there.position - at(piece, bench.now)[0]))
    orders = [line for line in bench.there.lines[said:] if line.startswith("s r0x2f")]
    assert len(orders) >= 50e-6 * (bench.now - begin)
    assert max(off) < 2500  # the fake drive turns in steps of 20 ms, by up to 1200 counts
    bench.run(1.0)
    assert not bench.frames[-1].flags & (State.FOLLOWING | State.BROKEN)
    assert bench.there.position == pytest.approx(0, abs=20)
    assert {frame.slow_value for frame in bench.frames if frame.slow_id == 8} >= {4 << 16 | 2}


def test_a_path_that_ends_early_or_is_stopped_is_held():
    for data in (
        None,
        {"flags": LinkCommandFlag.ARM | LinkCommandFlag.HOLD},
        {"flags": LinkCommandFlag.STOP},
    ):
        bench = following()
        bench.run(0.8)
        assert bench.frames[-1].flags & State.FOLLOWING
        if data:
            command(bench.link, bench.now, **data)
        else:
            bench.there.position += 30_000
        bench.run(0.2)
        assert bench.there.held[0x24] == 21
        where = bench.there.position
        bench.run(1.0)
        assert bench.there.position == where
        assert bool(bench.frames[-1].flags & State.BROKEN) == (data is None)
        assert not bench.frames[-1].flags & State.FOLLOWING


def test_a_fault_disarms_it():
    bench = LinkBench()
    bench.run(1.0)
    bench.arm(mode=Mode.POSITION, set_point=40000, velocity=10)
    bench.there.held[0xA4] = 1 << 9
    bench.run(0.5)
    assert not bench.frames[-1].flags & State.ARMED
    assert bench.there.held[0x24] == 0


def test_one_that_cannot_hold_is_switched_off_and_no_stop_switches_it_on():
    bench = LinkBench()
    bench.run(1.0)
    bench.arm(mode=Mode.VELOCITY, set_point=5000)
    bench.run(0.5)
    bench.there.error = 15
    for _ in range(5):
        command(bench.link, bench.now, flags=LinkCommandFlag.STOP)
        bench.run(0.3)
    assert bench.there.held[0x24] == Mode.OFF
    bench.arm(mode=Mode.VELOCITY, set_point=5000)
    bench.run(0.5)
    assert bench.there.held[0x24] == Mode.VELOCITY


def test_each_frame_echoes_what_was_taken_before_its_measurement():
    bench, told = LinkBench(), []
    bench.run(1.0)
    for _ in range(100):  # more often than the drive can be read
        command(bench.link, bench.now)
        told.append(bench.now)
        bench.run(0.02)
    frames = [frame for frame in bench.frames if frame.clock > told[0]]
    assert len(frames) > 5
    for frame in frames:
        assert frame.echo == max(clock for clock in told if clock <= frame.clock)
        assert frame.turnaround == frame.clock - frame.echo


def test_told_to_home_it_is_referenced_once_it_has():
    bench = LinkBench()
    bench.run(1.0)
    homings = bench.link.drive.homings
    bench.arm(mode=Mode.VELOCITY, set_point=5000)
    bench.run(0.5)
    bench.frames.clear()
    bench.there.shakes = True  # so it does not begin
    command(
        bench.link, bench.now, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOME, mode=Mode.POSITION
    )
    told = bench.now
    bench.run(0.8)
    frames = [frame for frame in bench.frames if frame.echo == told]
    assert frames
    assert not any(frame.flags & State.REFERENCED for frame in frames)
    bench.there.shakes = False
    command(
        bench.link, bench.now, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOME, mode=Mode.POSITION
    )
    bench.run(0.8)
    assert bench.frames[-1].flags & State.REFERENCED
    assert bench.link.drive.homings == homings + 1


def test_once_disarmed_by_a_fault_it_must_be_told_to_disarm():
    bench = LinkBench()
    bench.run(1.0)
    bench.arm(mode=Mode.POSITION, set_point=40000, velocity=10)
    bench.there.held[0xA4] = 1 << 9
    bench.run(0.3)
    bench.there.held[0xA4] = 0
    bench.run(0.3)
    command(bench.link, bench.now, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOLD)
    bench.run(0.5)
    assert not bench.frames[-1].flags & State.ARMED
    bench.arm(mode=Mode.POSITION, set_point=40000, velocity=10)
    bench.run(0.5)
    assert bench.frames[-1].flags & State.ARMED


def reset(drive, baud):
    drive.switch_on()
    drive.baud = drive.held[0x90] = baud


def end_of_power(drive):
    reset(drive, 9600)


def quick_reset(drive):
    reset(drive, drive.baud)


def blocked(drive):
    drive.reported = 1 << 11  # the enable input


def reset_bit(drive):
    drive.reset = True


@pytest.mark.parametrize("goes_on", ["stop", "hold", "watchdog"])
@pytest.mark.parametrize("happening", [end_of_power, quick_reset, blocked, reset_bit])
def test_nothing_switches_a_dropped_drive_on_again(happening, goes_on):
    flags = {
        "stop": LinkCommandFlag.STOP,
        "hold": LinkCommandFlag.ARM | LinkCommandFlag.HOLD,
        "watchdog": LinkCommandFlag.STOP,
    }[goes_on]
    bench = LinkBench()
    bench.there.reset = False
    bench.run(1.0)
    bench.arm(mode=Mode.VELOCITY, set_point=5000)
    bench.run(3.0 if goes_on == "watchdog" else 0.5)

    def again(seconds):
        modes = []
        for _ in range(round(seconds / 0.2)):
            command(bench.link, bench.now, flags=flags)
            bench.run(0.2)
            modes.append(bench.there.held[0x24])
        return modes

    if goes_on != "watchdog":
        assert again(1.0)[-1] == Mode.POSITION
    happening(bench.there)
    again(1.0)
    bench.there.reported = 0
    assert set(again(3.0)) == {Mode.OFF}
    bench.arm(mode=Mode.VELOCITY, set_point=5000)
    bench.run(0.5)
    assert bench.there.held[0x24] == Mode.VELOCITY


# --- on a port ---


class Rig:
    """A session and a transport to a drive on a pseudo-terminal, in real time."""

    def __init__(self, folder):
        self.end = ENDS["pty"](folder)
        self.peer = DriveOnPty(self.end)
        url = self.end.url.replace("serial://", "copley://")
        self.transport = open_transport(url)
        self.session = LinkSession(1, paper_arm().links[0])
        self.sent = 0

    def until(self, condition, timeout=20.0):
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, self.transport.problem
            now = time.time_ns()
            if now - self.sent > 100_000_000:
                self.transport.send(self.session.command(now))
                self.sent = now
            if self.transport.wait(0.02):
                for data in self.transport.receive():
                    self.session.feed(data, time.time_ns())

    def arm(self):
        self.until(lambda: not self.session.lost)
        self.session.arm(time.time_ns())
        self.until(lambda: self.session.arming is not Arming.ARMING)
        assert self.session.armed

    def set(self, mode, value=0.0, seconds=30.0):
        now = time.time_ns()
        self.session.set(mode, value, 0.0, 0.0, now + round(seconds * 1e9), now)

    def close(self):
        self.transport.close()
        self.peer.close()
        self.end.close()


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.close()


def test_a_drive_on_a_port_is_a_link(rig):
    rig.arm()
    rig.set(Mode.POSITION, 0.5)
    rig.until(lambda: rig.session.progress.ended)
    assert rig.session.progress.reason == ""
    assert rig.session.scale.position(rig.peer.drive.position) == pytest.approx(0.5, abs=1e-4)
    rig.transport.close()
    assert rig.peer.drive.held[0x24] == 0  # the process ends: the drive is switched off


def test_a_drive_on_a_port_follows_a_path(rig):
    rig.arm()
    begin = time.time_ns() + 10**9 // 2
    rig.session.give_path(3, begin, [0.0, 0.8, 1.6], [0.0, 0.2, 0.1], [0.0, 0.1, 0.0],
                          time.time_ns())  # fmt: skip
    rig.set(Mode.PATH, 3)
    for data in rig.session.segments(time.time_ns()):
        rig.transport.send(data)
    rig.until(lambda: rig.session.progress.ended)
    assert rig.session.progress.reason == ""
    assert rig.session.scale.position(rig.peer.drive.position) == pytest.approx(0.1, abs=1e-3)
    orders = [line for line in rig.peer.drive.lines if line.startswith("s r0x2f")]
    assert len(orders) > 1.6 * 50, len(orders)


def test_the_end_of_the_process_switches_off_a_joint_that_does_not_come_to_rest(rig):
    rig.arm()
    rig.set(Mode.VELOCITY, 0.1)
    rig.until(lambda: rig.peer.drive.velocity)
    rig.peer.drive.shakes = True
    rig.transport.close()
    assert rig.peer.drive.held[0x24] == 0


def pulled(rig, patch):
    rig.end.unplug()
    rig.until(lambda: "cannot use the port" in rig.transport.problem)
    rig.end.replug()


def pulled_again_at_once(rig, patch):
    pulled(rig, patch)
    gone_while_it_is_set_up(rig, patch)


def gone_while_it_is_set_up(rig, patch):
    rig.peer.drive.switch_on()  # so its rate is raised again
    patch.setattr(termios, "tcsetattr", go_in_mid_open)
    said = "cannot use the port: Input/output error"
    rig.until(lambda: rig.transport.problem == said)


def broken(rig, patch):
    patch.setattr(DriveLink, "poll", lambda *_: {}["nothing"])
    said = "cannot use the port: KeyError('nothing')"
    rig.until(lambda: rig.transport.problem == said)


@pytest.mark.parametrize("trouble", [pulled, pulled_again_at_once, gone_while_it_is_set_up, broken])
def test_whatever_goes_wrong_on_the_way_is_said_and_tried_again(rig, monkeypatch, trouble):
    rig.arm()
    with monkeypatch.context() as patch:
        trouble(rig, patch)
    rig.until(lambda: not rig.session.armed)
    rig.until(lambda: not rig.session.lost and not rig.transport.problem)
    rig.until(lambda: rig.peer.drive.held[0x24] == 0)


def test_a_port_without_a_drive_is_said(tmp_path):
    end = ENDS["pty"](tmp_path)
    transport = open_transport(end.url.replace("serial", "copley"))
    deadline = time.monotonic() + 20.0
    while not transport.problem and time.monotonic() < deadline:
        transport.wait(0.1)
    assert transport.problem == "no drive answers, neither at 9600 baud nor at the rate given"
    transport.close()
    end.close()


def test_a_port_that_is_not_there_is_said_at_once():
    with pytest.raises(TransportError, match="No such file or directory"):
        open_transport("copley:///dev/no_such_port")
