"""Restarts of links and board, simulated and with their firmware, under replayed recordings.

An attacker records all frames before each restart and sends them again after it, at every time.
"""

from collections import Counter
from contextlib import closing
from functools import partial
from random import Random

import pytest
from base_firmware import FirmwareBoard, board_core
from firmware import Core, FirmwareLink, needs_arm, needs_emulator

from fss_arm_driver import protocol
from fss_arm_driver.protocol import State as Flags
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_base_driver import protocol as base_protocol
from fss_base_driver.session import BoardSession
from fss_sim import settings, testbed
from fss_sim.testbed import State

KEYS = {0: bytes(range(16)), 2: bytes(range(1, 17))}
PERIOD = 50_000_000
EPOCH = 1_700_000_000 * SECOND
MAX_RESTARTS = 100
TIMEOUT, OUTAGE = 0.5, 6 * SECOND // 10  # [s], [ns]
BOARD, LINK = 0, 2


class Simulated:
    """A simulated test bed, switched on in the states that `start` gives."""

    def __init__(self, keys, start):
        self.keys, self.start = keys, start
        self.settings = settings.TestbedSettings(preset="ideal")
        self.boots = []

    def restart(self):
        self.make()
        if self.boots[-1:] == [self.boot]:  # by chance, 1 in 65535, or always
            self.make()
        self.boots.append(self.boot)

    def make(self):
        arm, noise = self.settings.description(), self.settings.noise()
        state = self.start(self.settings)
        self.bed = testbed.Testbed(arm, noise, 1, state, 20.0, self.keys, board_rate=20.0)

    @property
    def boot(self):
        return self.bed.board.state.gate.boot

    def send(self, part, data):
        if part == BOARD:
            self.bed.receive_base(data, "driver")
        else:
            self.bed.receive(part - 1, data, "driver")

    def run(self):
        """Run one period; return the frames of each part."""
        reports = [self.bed.step() for _ in range(5)]
        sent = {BOARD: [r.board for r in reports], LINK: [r.telemetry[LINK - 1] for r in reports]}
        return {part: [d.data for those in each for d in those] for part, each in sent.items()}

    def close(self):
        """Nothing is open."""


class Firmware:
    """Firmware of a link and of the board, on this computer or emulated."""

    def __init__(self, keys, boots, cortex_m3=False):
        self.keys, self.next, self.boots = keys, iter(boots), []
        self.cores = {BOARD: board_core(cortex_m3), LINK: Core(cortex_m3)}

    def restart(self):
        boot = next(self.next)
        self.boots.append(boot)
        self.parts = {
            BOARD: FirmwareBoard(self.cores[BOARD], boot, self.keys.get(BOARD)),
            LINK: FirmwareLink(self.cores[LINK], LINK, boot, self.keys.get(LINK)),
        }

    def send(self, part, data):
        self.parts[part].send(data)

    def run(self):
        frames = {BOARD: self.parts[BOARD].run(PERIOD // 1000), LINK: self.parts[LINK].run(0.05)}
        encode = {BOARD: base_protocol.encode, LINK: protocol.encode}
        return {
            part: [encode[part](frame, self.keys.get(part)) for frame in sent]
            for part, sent in frames.items()
        }

    def close(self):
        for core in self.cores.values():
            core.close()


class Laboratory:
    """Sessions of one computer, the parts that they drive, and an attacker's recordings."""

    def __init__(self, world, keys):
        self.world, self.signed, self.now = world, bool(keys), EPOCH
        self.sessions = {
            BOARD: BoardSession(TIMEOUT, 2.0, key=keys.get(BOARD)),
            LINK: LinkSession(LINK, paper_arm().links[LINK - 1], TIMEOUT, key=keys.get(LINK)),
        }
        self.received, self.sent_commands = (
            {BOARD: [], LINK: []},
            {BOARD: [], LINK: []},
        )  # since the start
        self.recorded = {BOARD: [], LINK: []}  # telemetry from before it
        self.observed = Counter()  # replayed frames; accepted frames by state

    def restart(self):
        """Restart all parts; the attacker commands them before the computer does."""
        commands, self.sent_commands = self.sent_commands, {BOARD: [], LINK: []}
        self.recorded, self.received = self.received, {BOARD: [], LINK: []}
        self.observed["armed"] = 0
        self.world.restart()
        self.now += OUTAGE
        for part, those in commands.items():
            self.observed["commands"] += len(those)
            for data in those:
                self.world.send(part, data)

    def step(self):
        """Run one period; the recording is replayed before and after each frame."""
        self.now += PERIOD
        for part, session in self.sessions.items():
            self.sent_commands[part].append(session.command(self.now))
            self.world.send(part, self.sent_commands[part][-1])
        for part, frames in self.world.run().items():
            self.replay(part)
            for data in frames:
                self.received[part].append(data)
                self.count_states(self.sessions[part].feed(data, self.now))
                self.replay(part)

    def replay(self, part):
        """Replay telemetry; without a key, only to parts that are not lost: lost ones accept it."""
        session = self.sessions[part]
        for data in self.recorded[part]:
            if self.signed or not session.lost:
                self.observed["replayed"] += 1
                assert session.feed(data, self.now) is None

    def count_states(self, received):
        if received:
            self.observed["armed"] += bool(received.frame.flags & Flags.ARMED)
            self.observed["open"] += bool(getattr(received.frame, "valves", 0))

    def until(self, condition):
        for _ in range(60):
            if condition():
                return
            self.step()
        pytest.fail("the condition did not hold within 3 s")

    def arm_and_open(self):
        """Run from a restart until the board's valves are open and the link is armed."""
        sessions, starts = self.sessions.values(), len(self.world.boots)
        self.until(lambda: all(s.counts["adopted"] == starts for s in sessions))
        assert not self.observed["armed"]  # despite the replay
        for session in sessions:
            session.arm(self.now)
        self.until(lambda: all(s.armed for s in sessions))
        self.sessions[BOARD].thrust([0.2] * 8, self.now, self.now)
        opened = self.observed["open"]
        self.until(lambda: self.observed["open"] > opened + 2)


def initial_state(settings):
    return settings.initial_state(4)


def repeated_state(_):
    return State(frame=0, boots=1, rests=0, q=7 * (0.0,), qd=7 * (0.0,), boot_offset=0)


def distinct_boots():
    return Random(7).sample(range(1, 65536), MAX_RESTARTS + 1)


def repeated_boots():
    return (MAX_RESTARTS + 1) * [7]


def simulated(start):
    return lambda keys: Simulated(keys, start)


def firmware(boots, cortex_m3=False):
    return lambda keys: Firmware(keys, boots(), cortex_m3)


emulated = partial(pytest.param, marks=[pytest.mark.slow, needs_arm, needs_emulator])
CASES = [
    pytest.param(simulated(initial_state), {}, id="simulated, no keys"),
    pytest.param(simulated(initial_state), KEYS, id="simulated, keys"),
    pytest.param(simulated(repeated_state), KEYS, id="simulated, keys, boot repeated"),
    pytest.param(firmware(distinct_boots), {}, id="firmware, no keys"),
    pytest.param(firmware(distinct_boots), KEYS, id="firmware, keys"),
    pytest.param(firmware(repeated_boots), KEYS, id="firmware, keys, boot repeated"),
    emulated(firmware(distinct_boots, True), {}, id="emulated, no keys"),
    emulated(firmware(distinct_boots, True), KEYS, id="emulated, keys"),
    emulated(firmware(repeated_boots, True), KEYS, id="emulated, keys, boot repeated"),
]


@pytest.mark.parametrize("restarts", [20, pytest.param(MAX_RESTARTS, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("world", "keys"), CASES)
def test_frames_recorded_before_a_restart_are_rejected_after_it(world, keys, restarts):
    with closing(world(keys)) as parts:
        laboratory = Laboratory(parts, keys)
        for _ in range(restarts + 1):
            laboratory.restart()
            laboratory.arm_and_open()
    counts = laboratory.observed
    print(f"replayed: {counts['replayed']} frames, {counts['commands']} commands; 0 accepted")
    assert counts["open"] > 2 * restarts
    assert counts["replayed"] > 100 * restarts
    assert counts["commands"] >= 10 * restarts
