"""Execution of an activity: start, reasons to end, resources, feedback, and what is published."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_gnc.guidance.activity import ActivityError, Commands, Craft, Observation, Outcome
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.execution import Kind, start_activity
from fss_gnc.guidance.kinds import KINDS
from fss_gnc.guidance.mission_monitor import MissionMonitor
from fss_gnc.guidance_topics import command_messages, end_messages
from fss_gnc.reference import Body

CRAFT = Craft(paper_arm())
AT_REST = Body(np.zeros(3), np.zeros(3))
GOAL = SimpleNamespace(pose=[0.0] * 3, duration=0.0)


class Steps:
    """An activity that returns given commands, or fails."""

    def __init__(self, *commands, tolerates=False):
        self.left, self.is_tolerant, self.canceled = list(commands), tolerates, ""

    def tolerates(self, obs):
        return self.is_tolerant

    def step(self, obs):
        if not self.left:
            raise ActivityError("it has ended")
        return self.left.pop(0)

    def cancel(self, reason):
        self.canceled = reason

    interrupt = cancel


def execute(*commands, **options):
    kind = Kind("mission/capture", None, lambda *_: Steps(*commands, **options), None, None)
    return start_activity(kind, CRAFT, GOAL, observation(), 0)


def observation(t=0.0, *torques):
    return Observation(t, AT_REST, None, *np.zeros((2, 4)), np.array(torques) if torques else None)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("running", KINDS, ids=lambda kind: kind.name)
def test_a_motion_yields_to_all_and_a_mission_to_an_abort_only(kind, running):
    kind = Kind(kind.name, None, lambda *_: Steps(), None, None, kind.preempts)
    if running.name.startswith("base/") or kind.name == "mission/abort":
        assert start_activity(kind, CRAFT, GOAL, observation(), 0, running=running).kind is kind
        return
    with pytest.raises(ActivityError, match=f"{running.name} is running, cancel it first"):
        start_activity(kind, CRAFT, GOAL, observation(), 0, running=running)


@pytest.mark.parametrize(("problem", "words"), [("", "no target"), ("base is old", "base is old")])
def test_an_unknown_state_explains_why_an_activity_does_not_start(problem, words):
    def start(*_):
        raise ActivityError("no target")

    kind = Kind("mission/capture", None, start, None, None)
    with pytest.raises(ActivityError, match=f"^{words}$"):
        start_activity(kind, CRAFT, GOAL, Observation(0.0), 0, problem=problem)


@pytest.mark.parametrize(
    ("t", "problem", "tolerates", "reason"),
    [
        (1.0, "", False, "it has ended"),
        (-0.1, "", True, "the clock jumped back"),
        (1.0, "waiting for base/state", False, "waiting for base/state"),
        (1.0, "waiting for base/state", True, "it has ended"),
    ],
)
def test_it_aborts_with_a_reason(t, problem, tolerates, reason):
    commands = execute(tolerates=tolerates).step(observation(t), False, problem)
    assert (commands.phase, commands.outcome) == ("abort", Outcome(False, reason))


def test_it_is_canceled_by_its_activity():
    execution = execute(Commands("reach"), Commands("brake"))
    assert execution.step(observation(), False, "").phase == "reach"
    assert not execution.activity.canceled
    assert execution.step(observation(1.0), True, "").phase == "brake"
    assert execution.activity.canceled == "canceled"
    assert execution.budget.elapsed == 1.0


def test_it_coasts_and_is_interrupted_while_control_ignores_its_reference():
    execution = execute(Commands("reach"), Commands("brake"))
    stalled = replace(observation(1.0), stall="control paused for 2.0 s")
    commands = execution.step(stalled, False, "")
    assert commands == Commands("coast", reason=stalled.stall)
    assert dict(command_messages(execution, commands, 1.0, 1.0, 7))["base/trajectory"].points == []
    assert execution.activity.canceled == stalled.stall
    assert execution.step(observation(2.0), False, "").phase == "reach"  # its next step


def test_a_new_phase_or_problem_is_logged_once():
    execution = execute()
    found = [
        (execution.log_lines(Commands(phase, reason=reason)), execution.status)
        for phase, reason in (
            ("reach", ""), ("brake", ""), ("brake", "near"), ("brake", "near"), ("brake", "far"),
            ("brake", ""),
        )
    ]  # fmt: skip
    name = "mission/capture"
    assert found == [
        ([(f"{name}: reach", False, False)], name),
        ([(f"{name}: brake", False, False)], name),
        ([(f"{name}: brake: near", True, False)], f"{name}: brake: near"),
        ([], f"{name}: brake: near"),
        ([(f"{name}: brake: far", True, False)], f"{name}: brake: far"),
        ([], name),
    ]


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("coast", [False, True])
def test_at_the_end_the_valves_close_and_joints_stop_unless_another_follows(moves, coast):
    execution = execute(Commands("reach", rates=np.full(4, 0.1) if moves else None))
    commands = execution.step(observation(), False, "")
    started = dict(command_messages(execution, commands, 0.0, 1.0, 7))
    assert ("arm/joint_commands" in started) == moves
    ended = dict(end_messages(execution, Outcome(False, "stopped"), 4, 7, coast=coast))
    expected = ["base/trajectory"] * coast + ["arm/joint_commands"] * (coast and moves)
    assert list(ended) == [*expected, "mission/state"]
    if coast:
        assert not ended["base/trajectory"].points
    if coast and moves:
        assert ended["arm/joint_commands"].velocity.tolist() == [0.0] * 4
    state = ended["mission/state"]
    assert (state.mission, state.phase, state.reason) == ("capture", "abort", "stopped")


FOLDED = replace(observation(), q=np.array([1.5, -1.5, -1.5, 1.5]), holds=True)
GOAL_FIELDS = {
    "base/go_to": {"pose": [0.1, 0.0, 0.0]},
    "base/follow": {"time": [0.0, 9.0], "pose": 6 * [0.0]},
}
DONE = {
    "base/hold": "held",
    "base/go_to": "reached",
    "base/follow": "reached",
    "mission/capture": "stopped",
    "mission/detumble": "stopped",
    "mission/abort": "safe",
}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_feedback_and_results_fit_their_actions(kind):
    goal = kind.action.Goal(**GOAL_FIELDS.get(kind.name, {}))
    if kind.name == "mission/capture":
        goal.detumble = True
    activity = kind.start(CRAFT, FOLDED, goal)
    kind.action.Feedback(**kind.feedback(activity, activity.step(FOLDED)))
    for success in (False, True):
        fields = kind.result(activity, Budget(CRAFT), Outcome(success))
        result = kind.action.Result(message="", **fields)
        assert getattr(result, DONE[kind.name]) == (success or kind.name == "mission/abort")


@pytest.mark.parametrize(
    ("reason", "shown"),
    [("", "requested by the operator"), ("lost\nit", "lost it"), (9000 * "x", 200 * "x")],
)
def test_abort_shortens_any_reason_to_one_line(reason, shown):
    kind = KINDS[-1]
    assert kind.start(CRAFT, FOLDED, kind.action.Goal(reason=reason)).reason == shown


def test_missing_torque_of_a_joint_hides_no_other():
    budget = Budget(CRAFT)
    budget.update(observation(0.0, 0.5, np.nan, -1.5, 0.0))
    budget.update(observation(0.1, np.nan, np.nan, np.nan, np.nan))
    assert budget.largest_torque == pytest.approx(1.5)


def test_lasting_overload_of_a_joint_is_reported():
    monitor = MissionMonitor(CRAFT)
    reasons = [
        monitor.abort_reason(observation(t, 0.0, np.nan, -3.2, 0.0), None, "reach", 60.0, 0.0)
        for t in (0.0, 0.2, 0.4)
    ]
    assert reasons == ["", "", "torque of joint 3 is 3.20 N m, expected at most 3 N m"]


def test_phase_timeout_is_reported():
    still = observation(7.0, *4 * [0.0])
    reason = MissionMonitor(CRAFT).abort_reason(still, None, "reach", 5.0, 1.0)
    assert reason == "phase reach took longer than its timeout of 5 s"
