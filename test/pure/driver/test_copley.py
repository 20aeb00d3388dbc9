"""The servo drive's own language, and a drive straight on the computer's serial port.

What it does as a link is tested together with the firmware, in `test_firmware.py`.
"""

import termios
import time
from dataclasses import replace

import pytest
from driver_drive import CopleyLink, DriveOnPty
from driver_frames import DISARM, MOVE
from driver_wire import ENDS, go_in_mid_open
from firmware import Core
from running import wait_until

from fss_arm_driver.copley import drive
from fss_arm_driver.copley.language import ERRORS, Error, LineError, Ok, Value, parse
from fss_arm_driver.copley.link import DriveLink
from fss_arm_driver.protocol import LinkCommandFlag, Mode, State
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


@pytest.fixture
def link(core):
    link = CopleyLink(core)
    link.run(1.0)
    link.orders()
    return link


@pytest.mark.parametrize("working", [9600, 115_200])
def test_a_drive_is_found_at_both_rates_and_set_to_the_working_one(core, working):
    link = CopleyLink(core, baud=working)
    assert link.run(2.0)[-1].flags == State.REFERENCED
    assert link.orders() == ["s r0x90 115200"] * (working != 9600)
    assert link.joint().baud == link.link.drive.baud == working


@pytest.mark.parametrize("code", [1, 15, 48])
def test_whatever_is_refused_is_held_and_said(link, code):
    assert link.send(DISARM)
    link.tell(f"fail {code}")
    assert link.send(MOVE)
    frame = link.run(0.5)[-1]
    assert f"error {code}: {ERRORS[code]}" in link.link.drive.refusal
    assert frame.position == 0
    assert frame.mode in (Mode.POSITION, Mode.OFF)
    assert link.send(replace(DISARM, sequence=3))
    link.run(0.5)
    assert link.link.drive.refusal == ""
    assert link.joint().mode == Mode.OFF


def test_a_demand_made_again_while_braking_is_followed(link):
    assert link.send(DISARM)
    assert link.send(MOVE)
    link.tell("shake 1")
    link.run(0.5)
    hold = LinkCommandFlag.ARM | LinkCommandFlag.HOLD
    assert link.send(replace(MOVE, sequence=3, flags=hold))
    link.run(0.4)
    link.orders()
    assert link.send(replace(MOVE, sequence=4))
    link.run(0.4)
    assert link.orders()[-1] == "t 1"


def test_noise_in_an_answer_is_asked_again(link):
    link.answer = b"v 1\xff7\r"
    assert link.run(0.6)


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
