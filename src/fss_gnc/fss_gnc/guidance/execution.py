"""Execution of one activity: when it may start, its steps, and why it ends."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fss_arm_ros.log_line import LogLine
from fss_gnc.guidance.activity import (
    Activity,
    ActivityError,
    Commands,
    Craft,
    Observation,
    Outcome,
)
from fss_gnc.guidance.budget import Budget


@dataclass(frozen=True)
class Kind:
    """Definition of one action of the guidance."""

    name: str
    action: Any  # its type; its results have a `message`
    start: Callable[[Craft, Observation, Any], Activity]  # from a goal; may raise ActivityError
    result: Callable[[Any, Budget, Outcome], dict[str, Any]]  # fields except `message`
    feedback: Callable[[Any, Commands], dict[str, Any]]
    preempts: tuple[str, ...] = ()  # prefixes of the names of the actions that it preempts


@dataclass
class Execution:
    """A running activity."""

    kind: Kind
    activity: Activity
    start_time: int  # [ns]
    budget: Budget
    moves_joints: bool = False  # True once it has commanded the arm
    phase: str = ""  # of the last commands
    problem: str = ""  # why it aborts, brakes or assumes a state, after the phase; empty: not so

    def step(self, obs: Observation, canceled: bool, problem: str) -> Commands:
        """Return the activity's commands; abort it if it cannot continue.

        Args:
            obs: known state.
            canceled: True if its end was requested.
            problem: why base or joints are unknown; empty if both are known.
        """
        self.budget.update(obs)
        if obs.t < 0.0:
            return _abort("the clock jumped back")
        if obs.stall:  # control follows again after a reference without points
            self.activity.interrupt(obs.stall)
            return Commands("coast", reason=obs.stall)
        if canceled:
            self.activity.cancel("canceled")
        if problem and not self.activity.tolerates(obs):
            return _abort(problem)
        try:
            commands = self.activity.step(obs)
        except ActivityError as error:
            return _abort(str(error))
        self.moves_joints |= commands.rates is not None and not commands.outcome
        return commands

    def log_lines(self, commands: Commands) -> list[LogLine]:
        """Store phase and reason of the commands; return a line if one of them is new."""
        before = self.phase, self.problem
        problem = commands.reason and f"{commands.phase}: {commands.reason}"
        self.phase, self.problem = commands.phase, problem
        if problem and problem != before[1]:
            return [LogLine(f"{self.kind.name}: {problem}", bad=True)]
        return [LogLine(f"{self.kind.name}: {self.phase}")] if self.phase != before[0] else []

    @property
    def status(self) -> str:
        """Name of the action, and the reason of its last commands, if any."""
        return ": ".join(filter(None, (self.kind.name, self.problem)))

    def feedback(self, commands: Commands) -> Any:
        """Return the feedback message of the action."""
        return self.kind.action.Feedback(**self.kind.feedback(self.activity, commands))

    def result(self, outcome: Outcome) -> Any:
        """Return the result message of the action."""
        fields = self.kind.result(self.activity, self.budget, outcome)
        return self.kind.action.Result(message=outcome.message, **fields)


def _abort(reason: str) -> Commands:
    return Commands("abort", outcome=Outcome(False, reason))


def start_activity(
    kind: Kind,
    craft: Craft,
    goal: Any,
    obs: Observation,
    start_time: int,
    *,
    problem: str = "",
    running: Kind | None = None,
) -> Execution:
    """Start the activity of a goal.

    Args:
        kind: its kind.
        craft: the spacecraft.
        goal: request of the action.
        obs: known state.
        start_time: present time [ns].
        problem: why base or joints are unknown; empty if both are known.
        running: kind of the running activity, which the new one must preempt; None: none runs.

    Raises:
        ActivityError: it cannot start; the running activity continues.
    """
    if running and not running.name.startswith(kind.preempts):
        raise ActivityError(f"{running.name} is running, cancel it first")
    try:
        activity = kind.start(craft, obs, goal)
    except ValueError as error:
        raise ActivityError(problem or str(error)) from None
    return Execution(kind, activity, start_time, Budget(craft))
