"""The live joint estimate: from what the nodes of other kinds hold, as they come and go."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
import yaml
from calib_joint import ARM, DRIFT, SETTINGS, day, draw_arm
from calib_kinds import CLOSELY, Bed, ask, make_node, maneuvering, recorded
from calib_rig import Sample, message, record
from std_srvs.srv import Trigger

from fss_arm_calib.calibration_node import CalibrationNode
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.joint.calibrate import Session, calibrate
from fss_arm_calib.joint.kind import JOINT, session_message, sessions_from_message
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES
from fss_arm_calib.messages import calibration_part
from fss_arm_calib.recompute import main as recompute
from fss_arm_calib.recompute import recalibrate
from fss_arm_model.description_file import from_yaml
from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import OK, WARN, Health

#: What the nodes are told, as in calib_joint.SETTINGS.
TOLD = {
    kind: {f.name: getattr(one, f.name) for f in fields(one) if getattr(one, f.name) != f.default}
    for kind, one in SETTINGS.items()
}


@pytest.fixture(scope="module")
def data():
    """By kind, of one day of a simulated arm."""
    rng = np.random.default_rng(3)
    return day(draw_arm(rng), rng).data


@pytest.fixture
def node(spin):
    """node(kind, **settings): the node of a kind by its name, destroyed after the test."""

    def make(kind, **settings):
        known = {**JOINT_SOURCES, "joint": JOINT}[kind]
        made = make_node(known, **{**TOLD.get(kind, {}), **settings})
        spin(made, lambda: True)
        return made

    return make


def end(node):
    node.executor.remove_node(node)
    node.destroy_node()


@pytest.fixture
def others(node, data, spin):
    """The nodes of all other kinds, by kind, each with its data, when they publish no more."""
    found = {kind: node(kind) for kind in JOINT_SOURCES}
    for kind, one in found.items():
        one.add_data(data[kind])
    results = {one.kind.topic: one for one in found.values()}

    def started_from_the_last(one):
        messages = {
            topic: results[topic].kind.to_message(results[topic].outcome, "world")
            for topic in one.kind.prior_results
        }
        return all(
            one.initial.with_message(*item).arm == one.initial.arm for item in messages.items()
        )

    spin(found.values(), lambda: all(map(started_from_the_last, found.values())))
    return found


def held(joint):
    """Numbers of data of each kind that it has solved from."""
    data = joint.data[-1].data if joint.data else {}
    return [len(data.get(kind, ())) for kind in JOINT_SOURCES]


def numbers(data):
    return [len(data[kind]) for kind in JOINT_SOURCES]


def all_heard(joint, data):
    """Each node publishes its data and then its result, which carries its settings."""
    return held(joint) == numbers(data) and set(joint.finder.gathered.settings) == set(
        JOINT_SOURCES
    )


def test_one_that_comes_late_hears_all_and_solves_as_the_mathematics_do(spin, others, node, data):
    """By the settings that the other nodes were given, of which it was told nothing."""
    joint, far = node("joint"), CalibrationNode(JOINT, namespace="fss2")
    assert joint.health() == Health(
        WARN, "waiting for kinematic, dynamic, drift", joint.health().values
    )
    spin([joint, far, *others.values()], lambda: all_heard(joint, data))
    assert far.data == []  # it is another vehicle's
    assert joint.health().level == OK
    assert joint.health().values["maneuvers"] == len(data["dynamic"])
    direct = calibrate([Session("live", data)], ARM, JointSettings(), JOINT_SOURCES, SETTINGS)
    assert joint.outcome.verdict == direct.verdict == "pass", joint.outcome.reason
    np.testing.assert_allclose(joint.outcome.values, direct.values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(joint.outcome.covariance, direct.covariance, rtol=1e-9)
    assert joint.outcome.provenance.data_hash == direct.provenance.data_hash
    told = yaml.safe_load(joint.outcome.provenance.parameters)
    assert told["drift"]["torque_deviation"] == DRIFT.torque_deviation
    assert sessions_from_message(session_message(joint.data, "fss")) == joint.data
    assert sessions_from_message(session_message([], "fss")) == []


def test_live_is_what_the_bag_says_and_can_be_recomputed(spin, node, tmp_path, capsys):
    """All nodes hear one flight; it is recorded, and the joint estimate made from the bag, too."""
    samples = maneuvering(tip=True, noise=(0.0005, 0.001))
    output, page = tmp_path / "new" / "arm.yaml", tmp_path / "report"
    bed, joint = Bed(JOINT), node("joint", output=str(output), report=str(page))
    others = [make_node(JOINT_SOURCES[kind], **given) for kind, given in CLOSELY.items()]
    hear = {}
    for one in others:
        for source in one.kind.inputs(one.settings, 4):
            hear.setdefault(source.topic, []).append((one, source.feed))
    for topic, content in map(message, samples):
        for one, feed in hear[topic]:
            one.on_sample(feed, content)
    for one in others:
        one.on_solve(Trigger.Request(), Trigger.Response())
    counts = [len(one.data) for one in others]
    assert min(counts) >= 8
    spin([bed, joint, *others], lambda: held(joint) == counts)
    answer = ask(spin, bed, joint, bed.solver)
    assert answer.success, answer.message
    spin([bed, joint], lambda: bed.results and calibration_part(bed.results[-1]).verdict == "pass")
    result, session = bed.results[-1], bed.data[-1]
    found = calibration_part(result)
    assert (found.kind, found.provenance.source, found.header.frame_id) == ("joint", "live", "fss")

    bag = record(tmp_path / "bag", samples)
    params, files = tmp_path / "params.yaml", tmp_path / "joint.json"
    params.write_text(
        yaml.safe_dump({**CLOSELY, "dynamic": {"ros__parameters": CLOSELY["dynamic"]}})
    )
    asked = ["--params", str(params), "--max-relative=2", "--result", str(files)]
    assert from_bag(["--joint", str(bag), *asked]) == 0
    offline = json.loads(files.read_text())
    assert found.provenance.data_hash == offline["provenance"]["data_hash"]
    np.testing.assert_allclose(found.values, offline["values"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found.covariance, np.ravel(offline["covariance"]), rtol=1e-9, atol=1e-15
    )

    capsys.readouterr()
    assert recompute([recorded(tmp_path / "told", JOINT, (session, result))]) == 0
    assert "pass: the same" in capsys.readouterr().out
    assert recalibrate(JOINT, result, session).description == found.description
    assert from_yaml(output.read_text()) == from_yaml(found.description)
    assert output.with_suffix(".urdf").exists()
    assert {"g_x", "torque"} <= {*result.own}
    text = (page / "index.html").read_text()
    for words in ("x without dynamic", *JOINT.unavailable.values()):
        assert words in text


@pytest.fixture
def joint(spin, others, node, data):
    """The node that has solved from all that the others hold."""
    joint = node("joint")
    spin([joint, *others.values()], lambda: all_heard(joint, data))
    return joint


def test_what_is_told_again_not_understood_or_of_another_arm_is_left_out(spin, joint, others, data):
    drift, solved, add_data = others["drift"], [], joint.add_data
    joint.add_data = lambda found: solved.append(len(found)) or add_data(found)
    drift.publish()
    spin([joint, *others.values()], lambda: len(solved) == 2)  # data and result
    assert solved == [0, 0]

    message = drift.kind.to_message(drift.outcome, "world")
    message.calibration.provenance.parameters = "{tilt: [1"
    inputs = {one.topic: one.feed for one in JOINT.inputs(joint.settings, 4)}
    joint.on_sample(inputs[drift.kind.topic], message)
    assert joint.health().values["rejected: invalid calibration/drift"] == 1
    assert all_heard(joint, data)

    drifts = [replace(one, q=(*one.q, 0.0)) for one in data["drift"]]
    message = drift.kind.data.to_message(drifts, "world")
    # Again and again: whatever that node has begun from meanwhile, it publishes its own.
    spin(
        [joint, *others.values()],
        lambda: drift.data_publisher.publish(message) or joint.streams().unknown,
    )
    assert joint.health().message == "the arm has no joint_5"
    assert held(joint) == numbers(data)
    joint.on_solve(Trigger.Request(), Trigger.Response())
    assert joint.outcome.verdict == "not_evaluated"
    assert "received joint_5, but 'paper' has 4 joints" in joint.outcome.reason


def test_it_keeps_what_a_node_that_ended_told_and_forgets_what_is_forgotten(
    spin, others, node, data, tmp_path
):
    """Also when it was killed meanwhile."""
    state, kept = str(tmp_path / "state.json"), numbers(data)
    joint = node("joint", state_file=state)
    spin([joint, *others.values()], lambda: all_heard(joint, data))
    end(others.pop("kinematic"))
    others["dynamic"].on_forget(Trigger.Request(), Trigger.Response())
    spin([joint, *others.values()], lambda: held(joint) == [kept[0], 0, kept[2]])
    assert joint.outcome.verdict != "pass"
    others["dynamic"].add_data(data["dynamic"])
    spin([joint, *others.values()], lambda: held(joint) == kept)
    second = node("joint", state_file=state)
    assert second.data == joint.data
    assert second.outcome.verdict == joint.outcome.verdict == "pass"
    np.testing.assert_array_equal(second.outcome.values, joint.outcome.values)
    answer = joint.on_forget(Trigger.Request(), Trigger.Response())
    assert answer.message == "1 session forgotten"
    assert held(joint) == [0, 0, 0]
    assert joint.outcome.verdict == "not_evaluated"
    others["drift"].on_solve(Trigger.Request(), Trigger.Response())
    spin([joint, *others.values()], lambda: held(joint) == [0, 0, kept[2]])


def test_a_clock_that_ran_back_at_another_node_is_taken_note_of(spin, others, node, data, tmp_path):
    """Else it would pass, and write, what that node calls not evaluated."""
    output, kinematic = tmp_path / "arm.yaml", others["kinematic"]
    joints = next(
        one for one in kinematic.kind.inputs(kinematic.settings, 4) if one.topic == "joint_states"
    )
    end = data["kinematic"][-1].end + 100 * SECOND
    for t in (end, end + 2 * SECOND, end - 20 * SECOND):  # the first counts once confirmed
        kinematic.on_sample(joints.feed, message(Sample(t, 1, (0.0, 0.0)))[1])
    kinematic.on_solve(Trigger.Request(), Trigger.Response())
    joint = node("joint", output=str(output))
    spin(
        [joint, *others.values()],
        lambda: all_heard(joint, data) and joint.data[-1].set_back["kinematic"],
    )
    assert joint.outcome.verdict == "not_evaluated"
    assert "clock of kinematic jumped back by 2" in joint.outcome.reason
    assert joint.health().message == "a clock jumped back: call kinematic/forget to reset"
    assert not output.exists()
    kinematic.on_forget(Trigger.Request(), Trigger.Response())
    kinematic.add_data(data["kinematic"])
    spin([joint, *others.values()], lambda: joint.outcome.verdict == "pass")
    assert output.exists()


def test_impossible_parameters_are_refused(ros):
    with pytest.raises(ValueError, match="'nothing', expected words"):
        make_node(JOINT, priors="nothing")
    with pytest.raises(ValueError, match="no parameter heading_deviation"):
        make_node(JOINT, heading_deviation=1.0)
