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
    """Publishes what it is told to have observed."""

    def __init__(self):
        super().__init__("kinematic")
        self.message = KinematicObservations()
        self.output = self.create_publisher(
            KinematicObservations, "calibration/observations", LATCHED
        )

    def observe(self, q, used=True):
        observation = KinematicObservation(q=q, used=used)
        observation.end = self.get_clock().now().to_msg()
        self.message.observations.append(observation)
        self.output.publish(self.message)


def make_node(**settings):
    known = {"postures": POSTURES, "rest": 0.2, "retry": 0.1, "silence": 0.5, **settings}
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


def test_all_postures_are_visited_in_order(spin_to_the_end):
    arm, experiment = FakeArm(), make_node()
    assert spin_to_the_end(arm, experiment) == 0
    assert arm.goals == ROWS
    assert experiment.log[-1] == "all 3 postures done"
    assert "posture 2 of 3: moving to [-29, 0, 29, 6] degrees" in experiment.log


def test_a_rest_that_a_gap_spoiled_is_repeated(spin, spin_to_the_end):
    arm, observer, experiment = FakeArm(), FakeObserver(), make_node()
    nodes, rejected = (arm, observer, experiment), [0.3, 0.2, 0.1, 0.0]
    for count, row in enumerate([*ROWS, rejected], 1):
        spin(nodes, lambda k=count: len(arm.goals) == k)
        if count == 2:
            observer.observe(rejected, used=False)
        observer.observe(row)
    assert spin_to_the_end(*nodes) == 0
    assert arm.goals == [*ROWS, rejected]
    assert "repeating rejected rests: 1" in experiment.log


def test_disarmed_links_are_waited_for_and_told_once(spin_to_the_end):
    disarmed = "link 2 is not armed"
    arm, experiment = FakeArm(disarmed, disarmed, disarmed), make_node()
    assert spin_to_the_end(arm, experiment) == 0
    assert arm.goals == [ROWS[0]] * 3 + ROWS
    assert sum(disarmed in line for line in experiment.log) >= 1


def test_it_keeps_its_move_alive_and_none_before(spin, spin_to_the_end):
    arm, experiment, heard = FakeArm("silence"), make_node(silence=60.0), []
    arm.create_subscription(UUID, "arm/move/alive", heard.append, 10)
    spin([arm, experiment], lambda: len(heard) > 2)
    assert arm.keep_alive == [0.5]
    assert heard[-1] == experiment.goal.result().goal_id
    experiment.sequencer.phase = Phase.REQUEST
    assert spin_to_the_end(arm, experiment) == 0
    ids = [bytes(goal.uuid) for goal in heard]
    assert ids == sorted(ids, key=ids.index)  # no goal's again after the next one's


def test_after_its_process_stood_still_a_person_must_start_it_again(spin, spin_to_the_end):
    arm, experiment = FakeArm("reach", "silence"), make_node(silence=60.0)
    spin([arm, experiment], lambda: len(arm.goals) == 2)
    experiment.last_tick -= 5.0  # as after SIGSTOP and SIGCONT
    words = spin_to_the_end(arm, experiment)
    assert words.startswith("this process was stalled for 5.")
    assert "after 1 of 3 postures; the next run starts over because state_file is not set" in words
    assert arm.goals == ROWS[:2]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_experiment_that_is_interrupted_says_how_far_it_is(spin, start, tmp_path, how):
    arm, state = FakeArm("reach", "reach", "silence"), tmp_path / "progress.json"
    experiment = start(
        "fss_arm_calib.experiment.experiment_node",
        "--ros-args",
        "-p",
        "rest:=0.1",
        "-p",
        "silence:=60.0",
        "-p",
        f"state_file:={state}",
    )
    spin([arm], lambda: len(arm.goals) == 3, 30.0)
    assert experiment.stop(how) == 130, experiment.output
    said = f"interrupted after 2 of 13 postures; the next run resumes from {state}\n"
    assert experiment.output.endswith(f"-c: {said}")


def test_an_arm_that_dies_and_returns(spin, spin_to_the_end):
    arm, experiment = FakeArm("silence"), make_node()
    spin([arm, experiment], lambda: arm.goals)
    arm.executor.remove_node(arm)
    arm.close()
    arm.destroy_node()
    spin([experiment], lambda: "waiting for arm/move" in experiment.log)
    returned = FakeArm()
    assert spin_to_the_end(returned, experiment) == 0
    assert returned.goals == ROWS


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
        ({"postures": [0.0, 1.5, 1.5, 1.5]}, "to posture 1, link 4 and base would be -"),
        (
            {"postures": [0.0, 1.5, 1.5, 0.0, 0.0, 0.0, 1.5, 1.5], "margin": 0.5},
            r"posture 1, link . and .* less than the 0.500 m expected",
        ),
        ({"retry": 0.0}, "retry is 0.0 s, expected a positive number"),
    ],
)
def test_impossible_parameters_are_refused(ros, settings, message):
    with pytest.raises(ValueError, match=message):
        make_node(**settings)


def test_a_wrong_progress_file_is_named(ros, tmp_path):
    (tmp_path / "progress.json").write_text('{"what": 1}')
    with pytest.raises(ValueError, match="does not contain the progress"):
        make_node(state_file=str(tmp_path / "progress.json"))


PLAN = """
maneuvers:
- {kind: sweep, q: [[0, 0, 0, 0], [0.5, 0, 0.5, 0.1], [0, 0, 0.1, 0]], durations: [2.0, 3.0]}
- {kind: single, q: [[0, 0, 0.1, 0], [0, 0.4, 0.1, 0]], durations: [1.5]}
"""


def test_maneuvers_are_made_with_pauses_between(spin_to_the_end, tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    arm = FakeArm()
    experiment = make_node(maneuvers=str(tmp_path / "plan.yaml"), pause=0.3)
    assert [stop.pause for stop in experiment.sequencer.waypoints] == [0.3, 0.0, 0.3, 0.3]
    assert [stop.duration for stop in experiment.sequencer.waypoints] == [0.0, 2.0, 3.0, 1.5]
    assert spin_to_the_end(arm, experiment) == 0
    assert arm.goals == [
        [0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.5, 0.1], [0.0, 0.0, 0.1, 0.0], [0.0, 0.4, 0.1, 0.0],
    ]  # fmt: skip


class FakeDynamic(Node):
    """Publishes what it is told to have observed of maneuvers."""

    def __init__(self):
        super().__init__("dynamic")
        self.message = Maneuvers()
        self.output = self.create_publisher(Maneuvers, "calibration/maneuvers", LATCHED)
        self.results = self.create_publisher(DynamicCalibration, "calibration/dynamic", LATCHED)

    def observe(self, reason=""):
        one = Maneuver(used=not reason, reason=reason)
        one.end = self.get_clock().now().to_msg()
        self.message.maneuvers.append(one)
        self.output.publish(self.message)

    def conclude(self, verdict, *deviations):
        names = [f"b_{i}" for i in range(1, 1 + len(deviations))]
        one = Calibration(verdict=verdict, names=names, deviations=deviations)
        if self.message.maneuvers:
            one.header.stamp = self.message.maneuvers[-1].end
        self.results.publish(DynamicCalibration(calibration=one))


def test_maneuvers_end_when_the_goal_is_met(spin, spin_to_the_end, tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN + "promised: {b_1: 0.0015}\n")
    arm, dynamic = FakeArm(), FakeDynamic()
    experiment = make_node(maneuvers=str(tmp_path / "plan.yaml"), pause=0.2, goal="b_i 0.002")
    nodes = (arm, dynamic, experiment)
    for so_far, second in ((2, 0.003), (3, 0.001)):
        spin(nodes, lambda n=so_far: len(arm.goals) == n)
        dynamic.conclude("pass", 0.001, second)
    dynamic.observe()
    assert spin_to_the_end(*nodes) == 0
    told = "b_1 ± 0.001 (goal 0.002, promised 0.0015), b_2 ± 0.001 (goal 0.002)"
    assert experiment.log[-1] == f"goal met after 3 of 4 postures: pass, {told}"
    assert len(arm.goals) == 3


def test_a_goal_of_what_is_not_estimated_is_refused(spin, spin_to_the_end, tmp_path):
    (tmp_path / "plan.yaml").write_text(PLAN)
    dynamic = FakeDynamic()
    experiment = make_node(maneuvers=str(tmp_path / "plan.yaml"), goal="c_1 0.002")
    dynamic.conclude("pass", 0.001)
    assert spin_to_the_end(dynamic, experiment).startswith("goal has 'c_1', expected one of b_1")


def test_a_maneuver_that_a_gap_spoiled_is_repeated(spin, spin_to_the_end, tmp_path):
    """After going back the way it came, of which nothing is asked."""
    (tmp_path / "plan.yaml").write_text(PLAN)
    arm, dynamic = FakeArm(), FakeDynamic()
    experiment = make_node(
        maneuvers=str(tmp_path / "plan.yaml"), pause=0.2, observation_timeout=60.0
    )
    nodes, gap = (arm, dynamic, experiment), "joint_2 silent for 0.80 s"
    a, b, c, d = (stop.q.tolist() for stop in experiment.sequencer.waypoints)
    for so_far, reason in (
        ([a, b, c], gap),
        ([a, b, c, b, a, b, c], ""),
        ([a, b, c, b, a, b, c, d], ""),
    ):
        spin(
            nodes,
            lambda so_far=so_far: (
                arm.goals == so_far and experiment.sequencer.phase is Phase.OBSERVE
            ),
        )
        dynamic.observe(reason)
    assert spin_to_the_end(*nodes) == 0
    assert arm.goals == [a, b, c, b, a, b, c, d]
    assert f"posture 3 of 4: {gap}; returning to repeat it" in experiment.log


def test_maneuvers_and_rests_that_contradict_themselves_are_refused(spin):
    observer, dynamic, experiment = FakeObserver(), FakeDynamic(), make_node()
    observer.observe([np.nan] * 4)
    dynamic.message.maneuvers.append(Maneuver(samples=[1], used=True))
    dynamic.observe()
    topics = "calibration/observations", "calibration/maneuvers"
    expected = {f"refused on {topic}": 1 for topic in topics}
    spin([observer, dynamic, experiment], lambda: refusals(experiment) == expected)
    assert not experiment.sequencer.rests
    assert not experiment.sequencer.maneuvers
