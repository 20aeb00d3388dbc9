"""The servo drive's own language, and a drive straight on the computer's serial port.

What it does as a link is tested together with the firmware, in `test_firmware.py`.
"""

import termios
import time
from dataclasses import replace

import pytest
from driver_drive import CopleyLink, DriveOnPty, exchange
from driver_frames import BOOT, DISARM, MOVE, path_segments
from driver_wire import ENDS, go_in_mid_open
from firmware import Core
from running import wait_until

from fss_arm_driver.copley import drive
from fss_arm_driver.copley.drive import REPLY_TIMEOUT, Demand, Drive, DriveGoal
from fss_arm_driver.copley.language import ERRORS, Error, LineError, Ok, Value, parse
from fss_arm_driver.copley.link import DriveLink
from fss_arm_driver.protocol import LinkCommandFlag, Mode, Slow, State, evaluate
from fss_arm_driver.session import LinkSession
from fss_arm_driver.transport import open_transport
from fss_arm_model.description import paper_arm
from fss_link.session import Arming
from fss_link.transport import TransportError

SECOND = 1_000_000  # [us]


# --- the language ---

LINES = {
    b"ok": Ok(), b"v 0": Value(0), b"v 134217728": Value(1 << 27), b"v -40000": Value(-40000),
    b"v -2147483648": Value(-(1 << 31)), b"v 4294967295": Value(0xFFFFFFFF), b"e 33": Error(33),
}  # fmt: skip
NO_LINES = [
    b"", b"o", b"ok ", b"OK", b"v", b"v ", b"v x", b"v 1 2", b"v --1", b"v 4294967296", b"e -1",
    b"e", b"\xff\xfe", b"v 99999999999", b"\nok", "v ²".encode(),
]  # fmt: skip


def test_lines_of_the_drive_are_read_and_others_refused():
    assert {line: parse(line) for line in LINES} == LINES
    for line in NO_LINES:
        with pytest.raises(LineError):
            parse(line)


def test_each_error_code_has_its_words():
    assert str(Error(18)) == "error 18: already moving"
    assert str(Error(99)) == "error 99: not in the guide"


# --- the drive ---


@pytest.fixture(scope="module")
def core():
    core = Core()
    yield core
    core.close()


class Bench:
    """A drive's two sides at a line, in simulated time."""

    def __init__(self, core, baud=115_200):
        self.core, self.here, self.now, self.answer = core, Drive(baud), 0, b""
        self.tell("drive")

    def tell(self, what):
        assert self.core.ask(what) == "done"

    def run(self, seconds=0.5, until=lambda: False):
        end = self.now + round(seconds * SECOND)
        while self.now < end and not until():
            line = self.here.poll(self.answer, self.now)
            self.answer = exchange(self.core, line, self.here.baud, 2000)
            self.now += 2000
        return self

    def orders(self):
        return [line for line in self.core.ask("orders").split("; ") if line[:1] in ("s", "t")]

    def demand(self, goal, *values):
        self.orders()
        self.here.demand = Demand(goal, *values)
        self.run()
        return self.orders()

    def mode(self):
        return int(self.core.ask("joint").split()[2])


@pytest.fixture
def bench(core):
    bench = Bench(core)
    return bench.run(2.0, lambda: bench.here.reading)


@pytest.mark.parametrize("working", [9600, 115_200])
def test_a_drive_is_found_at_both_rates_and_set_to_the_working_one(core, working):
    bench = Bench(core, working).run(2.0)
    assert bench.here.reading
    assert bench.here.referenced
    assert bench.orders() == ["s r0x90 115200"] * (working != 9600)
    assert int(core.ask("joint").split()[3]) == bench.here.baud == working
    bench.here = Drive(115_200)  # a driver that starts again
    bench.run(2.0)
    assert bench.here.reading
    assert bench.here.baud == 115_200


@pytest.mark.parametrize("code", [1, 15, 48])
def test_whatever_is_refused_is_held_and_said(bench, code):
    bench.tell(f"fail {code}")
    bench.demand(DriveGoal.POSITION, 40000, 70000)
    assert f"error {code}: {ERRORS[code]}" in bench.here.refusal
    assert bench.here.reading.position == 0
    assert bench.here.reading.mode in (Mode.POSITION, Mode.OFF)
    bench.demand(DriveGoal.RELEASE)
    assert bench.here.refusal == ""
    assert bench.mode() == Mode.OFF


def test_a_demand_made_again_while_braking_is_followed(bench):
    bench.tell("shake 1")
    bench.demand(DriveGoal.POSITION, 40000, 70000)
    bench.orders()
    bench.here.demand = Demand(DriveGoal.HOLD)
    bench.run(0.4)
    bench.here.demand = Demand(DriveGoal.POSITION, 40000, 70000)
    bench.run(0.4)
    assert bench.orders()[-1] == "t 1"


@pytest.mark.parametrize("goal", [DriveGoal.RELEASE, DriveGoal.HOLD])
def test_a_joint_found_in_motion_is_braked_with_the_drives_abort_deceleration(bench, goal):
    bench.demand(DriveGoal.VELOCITY, 300_000, 0, 7639)
    bench.demand(DriveGoal.VELOCITY, 300_000, 0, 100)  # would brake in half a minute
    bench.here = Drive(115_200)  # a driver that starts again
    bench.here.demand = Demand(goal)
    bench.run(1.0)
    rest = {DriveGoal.RELEASE: Mode.OFF, DriveGoal.HOLD: Mode.POSITION}[goal]
    orders = ["s r0x90 115200", "s r0x37 300", "s r0x2f 0", "s r0x24 11", f"s r0x24 {rest:d}"]
    assert bench.orders() == orders
    assert float(bench.core.ask("joint").split()[1]) == 0.0


@pytest.mark.parametrize("cut_at", range(0, 12, 3))
def test_a_cable_pulled_in_mid_line_costs_the_demand_and_not_the_drive(bench, cut_at):
    bench.here.demand = Demand(DriveGoal.VELOCITY, 5000)
    bench.run(0.002 * cut_at)
    exchange(bench.core, b"s r0x2", 115_200, 1000)  # the start of a line
    bench.tell("plug 0")
    bench.run(2.0)
    assert bench.here.reading is None
    bench.here.demand = Demand()
    bench.tell("plug 1")
    bench.run(4.0)
    assert bench.here.reading
    assert bench.here.reading.velocity == 0
    assert bench.mode() == Mode.OFF


def test_noise_in_an_answer_is_asked_again(bench):
    bench.here.poll(b"v 1\xff7\r", bench.now)
    assert bench.run(0.6).here.reading


def test_a_silent_drive_is_lost_in_time(bench):
    bench.tell("plug 0")
    bench.run(1.0, lambda: bench.here.reading is None)
    assert bench.here.reading is None
    assert bench.now < 4 * REPLY_TIMEOUT + SECOND


# --- as a link ---


@pytest.fixture
def link(core):
    link = CopleyLink(core)
    link.run(1.0)
    return link


def test_telemetry_comes_at_its_rate_and_says_what_there_is(link):
    frames = link.run(2.0)
    assert 9 <= len(frames) <= 11
    assert frames[-1].flags == State.REFERENCED
    assert frames[-1].torque_age == 255
    assert {frame.slow_id for frame in frames} == {1, 2, 4, 6, 7, 8, 9}


def test_each_frame_echoes_what_was_taken_before_its_measurement(link):
    told, frames = [], []
    for k in range(1, 101):  # more often than the drive can be read
        told.append(link.clock)
        assert link.send(replace(DISARM, sequence=k, clock=link.clock))
        frames += link.run(0.02)
    frames = [frame for frame in frames if frame.clock > told[0]]
    assert len(frames) > 5
    for frame in frames:
        assert frame.echo == max(clock for clock in told if clock <= frame.clock)
        assert frame.turnaround == frame.clock - frame.echo


KNOTS = [(3 * SECOND, 0, 0), (4 * SECOND, 40_000, 0), (5 * SECOND, 0, 0)]
PIECES = path_segments(KNOTS, boot=BOOT, clock=9, path=4)
FOLLOW = replace(
    MOVE, mode=Mode.PATH, set_point=4, velocity=700_000, acceleration=100_000, watchdog=60_000
)


@pytest.fixture
def following(link):
    """At 3.2 s; path 4 began at 3 s, goes to 40000 counts within 1 s, and back."""
    assert link.send(DISARM)
    assert link.send(FOLLOW)
    assert all(link.send(piece) for piece in PIECES)
    link.run(1.0)
    assert link.joint().mode == Mode.POSITION  # it holds
    link.run(3.2 - 1e-6 * link.clock)
    link.orders()
    return link


def test_a_path_is_followed_at_50_hz_or_more(following):
    begin, off, frames = following.clock, [], []
    while following.clock < PIECES[1].end - 20_000:
        frames += following.run(0.01)
        piece = PIECES[following.clock >= PIECES[1].begin]
        off.append(abs(following.joint().position - evaluate(piece, following.clock)[0]))
    orders = [line for line in following.orders() if line.startswith("s r0x2f")]
    assert len(orders) >= 50e-6 * (following.clock - begin)
    assert max(off) < 400  # 0.6 degrees
    frames += following.run(1.0)
    assert not frames[-1].flags & (State.FOLLOWING | State.BROKEN)
    assert following.joint().position == pytest.approx(0, abs=20)
    assert 4 << 16 | 2 in {frame.slow_value for frame in frames if frame.slow_id == Slow.PATH}


@pytest.mark.parametrize(
    "flags", [LinkCommandFlag.ARM | LinkCommandFlag.HOLD, LinkCommandFlag.STOP]
)
def test_a_path_that_is_stopped_is_held(following, flags):
    assert following.send(replace(FOLLOW, sequence=3, flags=flags))
    following.run(0.5)
    where = following.joint()
    frame = following.run(1.0)[-1]
    assert (where.velocity, where.mode) == (0, Mode.POSITION)
    assert following.joint() == where
    assert not frame.flags & (State.FOLLOWING | State.BROKEN)


# --- on a port ---


class Rig:
    """A session and a transport to a drive on a pseudo-terminal, in real time."""

    def __init__(self, core, folder):
        self.end = ENDS["pty"](folder)
        self.drive = DriveOnPty(core, self.end)
        self.transport = open_transport(self.end.url.replace("serial://", "copley://"))
        slack = {"timeout": 5.0, "watchdog": 10.0}  # of a busy computer
        self.session = LinkSession(1, paper_arm().links[0], **slack)
        self.sent = 0

    def step(self):
        now = time.time_ns()
        if now - self.sent > 100_000_000:
            self.transport.send(self.session.command(now))
            self.sent = now
        if self.transport.wait(0.02):
            for data in self.transport.receive():
                self.session.feed(data, time.time_ns())

    def until(self, condition):
        wait_until(condition, 20.0, self.step)

    def arm(self):
        self.until(lambda: not self.session.lost)
        self.session.arm(time.time_ns())
        self.until(lambda: self.session.arming is not Arming.ARMING)
        assert self.session.armed

    def close(self):
        self.transport.close()
        self.drive.close()
        self.end.close()


@pytest.fixture
def rig(core, tmp_path, monkeypatch):
    monkeypatch.setattr(drive, "REPLY_TIMEOUT", 2 * SECOND)  # of a busy computer
    rig = Rig(core, tmp_path)
    yield rig
    rig.close()


def test_a_drive_on_a_port_is_a_link(rig):
    rig.arm()
    now = time.time_ns()
    rig.session.set(Mode.POSITION, 0.2, 0.0, 0.0, now + 30 * 10**9, now)
    rig.until(lambda: rig.session.progress.ended)
    assert rig.session.progress.reason == ""
    position = rig.drive.joint().position
    assert rig.session.scale.position(position) == pytest.approx(0.2, abs=1e-4)
    rig.transport.close()
    assert rig.drive.joint().mode == Mode.OFF  # the process ends: the drive is switched off


def pulled(rig, patch):
    rig.end.unplug()
    rig.until(lambda: "cannot use the port" in rig.transport.problem)
    rig.end.replug()


def gone_while_it_is_set_up(rig, patch):
    rig.drive.ask("power")  # so its rate is raised again
    patch.setattr(termios, "tcsetattr", go_in_mid_open)
    said = "cannot use the port: Input/output error"
    rig.until(lambda: rig.transport.problem == said)


def broken(rig, patch):
    patch.setattr(DriveLink, "poll", lambda *_: {}["nothing"])
    said = "cannot use the port: KeyError('nothing')"
    rig.until(lambda: rig.transport.problem == said)


@pytest.mark.parametrize("trouble", [pulled, gone_while_it_is_set_up, broken])
def test_whatever_goes_wrong_on_the_way_is_said_and_tried_again(rig, monkeypatch, trouble):
    rig.arm()
    with monkeypatch.context() as patch:
        trouble(rig, patch)
    rig.until(lambda: not rig.session.armed)
    rig.until(lambda: not rig.session.lost and not rig.transport.problem)
    rig.until(lambda: rig.drive.joint().mode == Mode.OFF)


def test_a_port_without_a_drive_is_said(tmp_path):
    end = ENDS["pty"](tmp_path)
    transport = open_transport(end.url.replace("serial", "copley"))
    wait_until(lambda: transport.problem, 20.0, lambda: transport.wait(0.1))
    assert transport.problem == "no drive answers, neither at 9600 baud nor at the rate given"
    transport.close()
    end.close()


def test_a_port_that_is_not_there_is_said_at_once():
    with pytest.raises(TransportError, match="No such file or directory"):
        open_transport("copley:///dev/no_such_port")
