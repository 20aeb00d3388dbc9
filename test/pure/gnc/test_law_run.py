"""The run of a control law: which commands are valid, and when valves close and joints stop."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from law_bench import inputs

from fss_arm_model.units import SECOND
from fss_gnc.law import Outputs
from fss_gnc.law.contract import LawError
from fss_gnc.law.run import MAX_START_TIME, MAX_STEP_TIME, LawRun, stop_of

PERIOD, LIFETIME = 0.02, 0.3
OUTPUTS = Outputs(wrench=np.full(3, 0.01), joint_velocities=np.full(4, 0.02))


@dataclass
class FakeLaw:
    """A law that answers each step `delay` calls later; None: it never answers."""

    delay: int | None = 0
    ready: bool = True
    failure: str = ""
    killed: bool = False
    sent: list = field(default_factory=list)
    waiting: int | None = None

    def send(self, given):
        assert self.waiting is None
        self.sent.append(given)
        self.waiting = self.delay

    def receive(self, timeout):
        if self.failure:
            raise LawError(self.failure)
        if not self.sent or self.waiting is None:
            return None
        if self.waiting > 0:
            self.waiting -= 1
            return None
        self.waiting = None
        return OUTPUTS

    def kill(self):
        self.killed = True


class Bench:
    """A run whose time passes period by period."""

    def __init__(self, **law):
        self.law, self.time = FakeLaw(**law), 0.0
        self.run = LawRun(self.law, 4, PERIOD, LIFETIME, lambda: self.time)

    @property
    def now(self):
        return 1000 * SECOND + round(self.time * SECOND)

    def step(self, given=True):
        command = self.run.step(self.now, inputs() if given else None)
        self.time += PERIOD
        return command

    def steps(self, duration, given=True):
        """Return time and command of each that is published within a duration [s]."""
        end, found = self.time + duration, []
        while self.time < end:
            start = self.time
            if command := self.step(given):
                found.append((start, command))
        return found


def is_stop(command):
    o = command.outputs
    return command.is_stop and not o.wrench.any() and not o.joint_velocities.any()


def test_a_command_has_the_time_of_its_inputs():
    bench = Bench()
    now = bench.now
    command = bench.step()
    assert (command.outputs, command.stamp) == (OUTPUTS, now)
    assert command.measured == now - round(0.004 * SECOND)
    assert not command.is_stop


def test_nothing_is_sent_before_the_law_is_ready():
    bench = Bench(ready=False)
    assert not bench.steps(1.0)
    assert bench.run.is_starting
    assert not bench.law.sent
    assert bench.run.missed == 0
    bench.law.ready = True
    assert bench.step()


def test_a_late_output_counts_from_the_time_of_its_inputs():
    bench = Bench(delay=3)
    commands = [command for _ in range(8) if (command := bench.step())]
    assert [command.stamp for command in commands] == [1000 * SECOND, 1000 * SECOND + 80_000_000]
    assert bench.run.missed == 6
    assert bench.run.expired == 0


def test_an_output_older_than_its_time_to_live_is_dropped():
    bench = Bench(delay=20)  # 0.4 s
    assert not bench.steps(1.0)
    assert bench.run.expired == 2
    assert not bench.run.failure


def test_the_last_command_expires_and_then_all_stops_once():
    bench = Bench()
    last = bench.steps(0.2)[-1][1].stamp
    bench.law.delay = 40
    ((time, command),) = bench.steps(0.7)
    assert is_stop(command)
    assert 1000 * SECOND + time * SECOND - last == pytest.approx(
        LIFETIME * SECOND, abs=SECOND // 40
    )


def test_unknown_inputs_stop_at_once_and_commands_resume():
    bench = Bench()
    bench.step()
    assert is_stop(bench.step(given=False))
    assert not bench.steps(0.5, given=False)
    assert bench.step().outputs is OUTPUTS


def test_a_failure_stops_at_once_and_for_good():
    bench = Bench()
    bench.step()
    bench.law.failure = "SIGSEGV"
    assert is_stop(bench.step())
    assert (bench.run.failure, bench.law.killed) == ("SIGSEGV", True)
    assert bench.run.last == 1000 * SECOND
    assert not bench.steps(1.0)


def test_a_step_that_does_not_end_ends_the_law():
    bench = Bench()
    bench.step()
    bench.law.delay = None
    bench.steps(MAX_STEP_TIME)
    assert not bench.run.failure
    bench.steps(3 * PERIOD)
    assert bench.run.failure == "a step did not end within 1 s"
    assert bench.law.killed


def test_a_law_that_does_not_start_ends():
    bench = Bench(ready=False)
    bench.time = MAX_START_TIME + 1.0
    bench.step()
    assert bench.run.failure == "it did not start within 60 s"


def test_a_stop_ends_what_was_commanded_and_nothing_else():
    on_times = stop_of(Outputs(valve_on_times=np.ones(8), gripper_closed=True), 4)
    assert not on_times.valve_on_times.any()
    assert on_times.wrench is on_times.joint_velocities is on_times.gripper_closed is None
    currents = stop_of(Outputs(joint_currents=np.ones(4)), 4)
    assert currents.joint_velocities.tolist() == [0.0] * 4
    assert currents.wrench is currents.joint_currents is None
