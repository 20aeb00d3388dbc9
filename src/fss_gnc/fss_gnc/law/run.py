"""The run of a law: decides which commands are valid, and ends a law that fails or stalls.

A command is valid for its time to live after the time of its inputs. When there is no valid one,
the valves are closed and the joints stopped once; their drivers keep them so.
"""

import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from fss_arm_model.units import SECOND
from fss_gnc.law.contract import BASE_COMMANDS, JOINT_COMMANDS, VALVES, Inputs, LawError, Outputs

MAX_START_TIME = 60.0  # a law may import and compile [s]
MAX_STEP_TIME = 1.0  # of one step, and at least MIN_STEP_PERIODS [s]
MIN_STEP_PERIODS = 20.0


class Steps(Protocol):
    """Steps of a law, as LawProcess makes them."""

    ready: bool

    def send(self, inputs: Inputs) -> None:
        """Start a step."""

    def receive(self, timeout: float) -> Outputs | None:
        """Return the outputs of the step; None if it has not ended."""

    def kill(self) -> None:
        """End the law."""


class Command(NamedTuple):
    """Outputs of a law, with the times of their inputs and of the base's state in them [ns]."""

    outputs: Outputs
    stamp: int
    measured: int
    is_stop: bool = False  # True if it ends the commands before it


class LawRun:
    """Run of one law, from its start to its failure.

    Args:
        law: its process.
        joints: number of joints.
        period: between two steps [s].
        time_to_live: of a command after the time of its inputs [s].
        clock: monotonic clock [s].
    """

    def __init__(
        self,
        law: Steps,
        joints: int,
        period: float,
        time_to_live: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._law, self._joints, self._clock, self.period = law, joints, clock, period
        self._lifetime = round(time_to_live * SECOND)
        self._max_step_time = max(MAX_STEP_TIME, MIN_STEP_PERIODS * period)
        self._since = clock()  # start of the law, or of its present step [s]
        self._sent: tuple[int, int] | None = None  # times of the present step, as in Command
        self._active: Command | None = None  # last command, until it is replaced by a stop
        self.failure = ""  # reason why the law has ended
        self.last: int | None = None  # time of the inputs of the last valid output [ns]
        self.steps = self.missed = self.expired = 0

    def step(self, now: int, inputs: Inputs | None) -> Command | None:
        """Return the command to publish at `now` [ns], if any; wait for it for one period.

        Args:
            now: present time, which is that of the inputs [ns].
            inputs: None: unknown, so that nothing may move.
        """
        command = None
        if not self.failure:
            try:
                command = self._advance(now, inputs)
            except LawError as error:
                self._law.kill()
                self.failure = str(error)
        if command and inputs is not None:
            self._active = command
            return command
        return self._stop(now, inputs is None or bool(self.failure))

    def _advance(self, now: int, inputs: Inputs | None) -> Command | None:
        """Start a step if none is in progress; return the outputs if they are valid."""
        busy = self._sent is not None
        if self._law.ready and not busy and inputs is not None:
            self._law.send(inputs)
            self._sent = now, now - round(inputs.base_age * SECOND)
            self._since = self._clock()
        outputs = self._law.receive(self.period if self._sent is not None else 0.0)
        if outputs is None:
            self.missed += self._sent is not None
            self._check_time()
            return None
        assert self._sent is not None
        command, self._sent = Command(outputs, *self._sent), None
        self.steps, self.last = self.steps + 1, command.stamp
        if now - command.stamp > self._lifetime:
            self.expired += 1
            return None
        return command

    def _check_time(self) -> None:
        """Raise LawError if the law has not started, or ended its step, in time."""
        taken = self._clock() - self._since
        if self._sent is not None and taken > self._max_step_time:
            raise LawError(f"a step did not end within {self._max_step_time:g} s")
        if not self._law.ready and taken > MAX_START_TIME:
            raise LawError(f"it did not start within {MAX_START_TIME:g} s")

    def _stop(self, now: int, at_once: bool) -> Command | None:
        """Return the command that ends the active one, if that is due."""
        if self._active and (at_once or now - self._active.stamp > self._lifetime):
            stop, self._active = stop_of(self._active.outputs, self._joints), None
            return Command(stop, now, now, is_stop=True)
        return None

    def describe_last(self, now: int) -> str:
        """Describe the last valid output, at `now` [ns]."""
        if self.last is None:
            return "it gave no output"
        for_time, ago = self.last / SECOND, (now - self.last) / SECOND
        return f"its last valid output was for {for_time:.3f} s, {ago:.3f} s ago"

    @property
    def is_starting(self) -> bool:
        """True until the law accepts inputs."""
        return not self._law.ready and not self.failure


def stop_of(outputs: Outputs, joints: int) -> Outputs:
    """Return commands that close the valves and stop the joints, as far as commanded before."""
    wrench, on_times = (getattr(outputs, name) is not None for name in BASE_COMMANDS)
    moved = any(getattr(outputs, name) is not None for name in JOINT_COMMANDS)
    return Outputs(
        wrench=np.zeros(3) if wrench else None,
        valve_on_times=np.zeros(VALVES) if on_times else None,
        joint_velocities=np.zeros(joints) if moved else None,
    )
