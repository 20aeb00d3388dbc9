"""The experiment against a fake arm and a fake observer."""

import json
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.action import ActionServer
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from fss_arm_calib.experiment import sequencer
from fss_arm_calib.experiment.experiment_node import ExperimentNode
from fss_arm_calib.experiment.sequencer import Phase
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import (
    Calibration,
    DynamicCalibration,
    KinematicObservation,
    KinematicObservations,
    Maneuver,
    Maneuvers,
)
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.validation import refusals

POSTURES = [0.1, 0.2, 0.3, 0.4, -0.5, 0.0, 0.5, 0.1, 0.9, -0.9, 0.0, 0.2]
ROWS = np.reshape(POSTURES, (-1, 4)).tolist()
DATA = {KinematicObservation: "observations", Maneuver: "maneuvers"}
PLAN = """
maneuvers:
- {kind: sweep, q: [[0, 0, 0, 0], [0.5, 0, 0.5, 0.1], [0, 0, 0.1, 0]], durations: [2.0, 3.0]}
- {kind: single, q: [[0, 0, 0.1, 0], [0, 0.4, 0.1, 0]], durations: [1.5]}
promised: {b_1: 0.0015}
"""


class FakeArm(Node):
    """Answers `arm/move` by a script, one word for each goal; `reach` when it is used up."""

    def __init__(self, *script):
        super().__init__("arm")
        self.script, self.goals, self.keep_alive = list(script), [], []
        self.server = ActionServer(self, MoveArm, "arm/move", self.on_move)

    def close(self):
        self.server.destroy()

    async def on_move(self, handle):
        self.goals.append(list(handle.request.q))
        self.keep_alive.append(handle.request.keep_alive)
        what = self.script.pop(0) if self.script else "reach"
        if what == "silence":
            await Future()
        handle.publish_feedback(MoveArm.Feedback(q=handle.request.q, remaining=0.0))
        if what == "reach":
            handle.succeed()
            return MoveArm.Result(reached=True, q=handle.request.q)
        handle.abort()
        return MoveArm.Result(reached=False, message=what)


class FakeObserver(Node):
    """Publishes what it is told to have observed of rests, or of maneuvers."""

    def __init__(self, message=KinematicObservations, topic="observations"):
        super().__init__("observer")
        self.message = message()
        self.output = self.create_publisher(message, f"calibration/{topic}", LATCHED)
        self.results = self.create_publisher(DynamicCalibration, "calibration/dynamic", LATCHED)

    def observe(self, datum):
        datum.end = self.get_clock().now().to_msg()
        getattr(self.message, DATA[type(datum)]).append(datum)
        self.output.publish(self.message)

    def conclude(self, verdict, *deviations):
        names = [f"b_{i}" for i in range(1, 1 + len(deviations))]
        one = Calibration(verdict=verdict, names=names, deviations=deviations)
        if self.message.maneuvers:
            one.header.stamp = self.message.maneuvers[-1].end
        self.results.publish(DynamicCalibration(calibration=one))


@pytest.fixture(autouse=True)
def times(monkeypatch):
    """Failed moves are requested again at once; moves without feedback are not."""
    monkeypatch.setattr(sequencer, "RETRY_DELAY", 0.1)
    monkeypatch.setattr(sequencer, "FEEDBACK_TIMEOUT", 60.0)


def make_node(**settings):
    known = {"postures": POSTURES, "rest": 0.2, **settings}
    node = ExperimentNode(parameter_overrides=[Parameter(k, value=v) for k, v in known.items()])
    node.log = []
    logger = SimpleNamespace(info=node.log.append, warning=node.log.append)
    node.get_logger = lambda: logger
    node.close = node.move_client.destroy  # else it stays in the graph
    return node


@pytest.fixture
def spin_to_the_end(spin):
    """Spin nodes until the experiment ends; its exit code."""

    def run(*nodes, timeout=10.0):
        with pytest.raises(SystemExit) as end:
            spin(nodes, lambda: False, timeout)
        return end.value.code

    return run


def test_postures_are_visited_in_order_and_repeated_if_a_gap_spoiled_a_rest(spin, spin_to_the_end):
    """Links that are not armed are waited for."""
    disarmed = "link 2 is not armed"
    arm, observer, experiment = FakeArm(disarmed), FakeObserver(), make_node()
    nodes, rejected = (arm, observer, experiment), [0.3, 0.2, 0.1, 0.0]
    for count, row in enumerate([*ROWS, rejected], 2):
        spin(nodes, lambda k=count: len(arm.goals) == k)
        if count == 3:
            observer.observe(KinematicObservation(q=rejected))
        observer.observe(KinematicObservation(q=row, used=True))
    assert spin_to_the_end(*nodes) == 0
    assert arm.goals == [ROWS[0], *ROWS, rejected]
    assert f"requesting the move again: {disarmed}" in experiment.log
    assert "repeating rejected rests: 1" in experiment.log
    assert "posture 2 of 3: moving to [-29, 0, 29, 6] degrees" in experiment.log


def test_it_keeps_its_move_alive_and_none_before(spin, spin_to_the_end):
    arm, experiment, heard = FakeArm("silence"), make_node(), []
    arm.create_subscription(UUID, "arm/move/alive", heard.append, 10)
    spin([arm, experiment], lambda: len(heard) > 2)
    assert arm.keep_alive == [0.5]
    assert heard[-1] == experiment.goal.result().goal_id
    experiment.sequencer.phase = Phase.REQUEST
    assert spin_to_the_end(arm, experiment) == 0
    ids = [bytes(goal.uuid) for goal in heard]
    assert ids == sorted(ids, key=ids.index)  # no goal's again after the next one's


def test_after_its_process_stood_still_a_person_must_start_it_again(spin, spin_to_the_end):
    arm, experiment = FakeArm("reach", "silence"), make_node()
    spin([arm, experiment], lambda: len(arm.goals) == 2)
    experiment.last_tick -= 5.0  # as after SIGSTOP and SIGCONT
    words = spin_to_the_end(arm, experiment)
    assert words.startswith("this process was stalled for 5.")
    assert "after 1 of 3 postures; the next run starts over because state_file is not set" in words
    assert arm.goals == ROWS[:2]


def test_an_experiment_that_is_interrupted_says_how_far_it_is(spin, start, tmp_path):
    arm, state = FakeArm("reach", "reach", "silence"), tmp_path / "progress.json"
    given = "-p", "rest:=0.1", "-p", f"state_file:={state}"
    experiment = start("fss_arm_calib.experiment.experiment_node", "--ros-args", *given)
    spin([arm], lambda: len(arm.goals) == 3, 30.0)
    assert experiment.stop(signal.SIGINT) == 130, experiment.output
    said = f"interrupted after 2 of 13 postures; the next run resumes from {state}\n"
    assert experiment.output.endswith(f"-c: {said}")


def test_an_experiment_that_was_killed_goes_on(spin, spin_to_the_end, tmp_path):
    state = str(tmp_path / "progress.json")
    arm, first = FakeArm(), make_node(state_file=state)
    spin([arm, first], lambda: first.sequencer.progress.done == 2)
    begun = first.sequencer.progress.begun
    first.executor.remove_node(first)
    first.destroy_node()
    arm.goals.clear()
    second = make_node(state_file=state)
    assert second.sequencer.progress.begun == begun
    assert spin_to_the_end(arm, second) == 0
    assert arm.goals[-1:] == ROWS[2:]
    assert json.loads((tmp_path / "progress.json").read_text())["done"] == 3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"postures": POSTURES[:3]}, "postures has 3 numbers, expected 4 a row"),
        ({"postures": [0.0, 1.6, 0.0, 0.0]}, "joint 2 at 91.67 deg, expected -90 to 90 deg"),
        (
            {"postures": [0.0, 1.5, 1.5, 0.0, 0.0, 0.0, 1.5, 1.5], "margin": 0.5},
            r"posture 1, link . and .* less than the 0.500 m expected",
        ),
    ],
)
def test_impossible_parameters_are_refused(ros, settings, message):
    with pytest.raises(ValueError, match=message):
        make_node(**settings)


def test_a_wrong_progress_file_is_named(ros, tmp_path):
    (tmp_path / "progress.json").write_text('{"what": 1}')
    with pytest.raises(ValueError, match="does not contain the progress"):
        make_node(state_file=str(tmp_path / "progress.json"))


@pytest.fixture
def plan(tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    return str(tmp_path / "plan.yaml")


def test_maneuvers_end_when_the_goal_is_met(spin, spin_to_the_end, plan):
    arm, dynamic = FakeArm(), FakeObserver(Maneuvers, "maneuvers")
    experiment = make_node(maneuvers=plan, pause=0.2, goal="b_i 0.002")
    nodes, waypoints = (arm, dynamic, experiment), experiment.sequencer.waypoints
    assert [stop.pause for stop in waypoints] == [0.2, 0.0, 0.2, 0.2]
    assert [stop.duration for stop in waypoints] == [0.0, 2.0, 3.0, 1.5]
    dynamic.observe(Maneuver(reason="a gap"))  # before the first
    for so_far, second in ((2, 0.003), (3, 0.001)):
        spin(nodes, lambda n=so_far: len(arm.goals) == n)
        dynamic.conclude("pass", 0.001, second)
    assert [(one.used, one.reason) for one in experiment.sequencer.maneuvers] == [(False, "a gap")]
    dynamic.observe(Maneuver(used=True))
    assert spin_to_the_end(*nodes) == 0
    told = "b_1 ± 0.001 (goal 0.002, promised 0.0015), b_2 ± 0.001 (goal 0.002)"
    assert experiment.log[-1] == f"goal met after 3 of 4 postures: pass, {told}"
    assert arm.goals == [[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.5, 0.1], [0.0, 0.0, 0.1, 0.0]]


def test_a_goal_of_what_is_not_estimated_is_refused(spin_to_the_end, plan):
    dynamic = FakeObserver(Maneuvers, "maneuvers")
    experiment = make_node(maneuvers=plan, goal="c_1 0.002")
    dynamic.conclude("pass", 0.001)
    assert spin_to_the_end(dynamic, experiment).startswith("goal has 'c_1', expected one of b_1")


def test_maneuvers_and_rests_that_contradict_themselves_are_refused(spin):
    observers = FakeObserver(), FakeObserver(Maneuvers, "maneuvers")
    experiment = make_node()
    observers[0].observe(KinematicObservation(q=[np.nan] * 4, used=True))
    observers[1].observe(Maneuver(samples=[1], used=True))
    topics = "calibration/observations", "calibration/maneuvers"
    expected = {f"refused on {topic}": 1 for topic in topics}
    spin([*observers, experiment], lambda: refusals(experiment) == expected)
    assert not experiment.sequencer.rests
    assert not experiment.sequencer.maneuvers
