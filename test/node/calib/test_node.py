"""What the calibrations of all kinds have alike: node, state, bag, recomputation, report."""

import json
from dataclasses import fields, replace
from functools import cached_property

import numpy as np
import pytest
from calib_kinds import CASES, Bed, ask, make_node, play, recorded
from calib_rig import message, record
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_srvs.srv import Trigger

from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS, Check
from fss_arm_calib.calibration import CAUSES
from fss_arm_calib.drives.kind import DRIVES
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.from_bag_options import parser
from fss_arm_calib.kinds import KINDS, KINEMATIC
from fss_arm_calib.messages import calibration_part, common_message
from fss_arm_calib.node_settings import node_settings
from fss_arm_calib.recompute import main as recompute
from fss_arm_calib.recompute import recalibrate
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description_file import load
from fss_arm_model.urdf import urdf
from fss_arm_msgs.msg import Calibration
from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN
from fss_arm_ros.state_file import StateError

assert CASES.keys() == KINDS.keys()

#: A kind more: a record in the table is all that it takes, and the message that all share.
TOY = replace(
    KINEMATIC,
    name="toy",
    data=replace(KINEMATIC.data, topic="calibration/toy_rests"),
    message=Calibration,
    to_message=lambda outcome, frame: common_message("toy", outcome, frame),
    recomputed_fields=(),
)
POOR = {"position_deviation": 1e-7, "heading_deviation": 1e-7}  # no result is as good


class Made:
    """A kind with its samples, its bag, and what comes of it; each made once."""

    def __init__(self, case, kind, folder):
        self.case, self.kind = case, kind
        self.samples, self.folder = case.samples(), folder
        self.settings = self.kind.settings(**case.settings)

    @cached_property
    def bag(self):
        return record(self.folder / "bag", self.samples)

    @cached_property
    def outcome(self):
        return solve_bag(self.kind, self.bag, self.settings)

    def node(self, **settings):
        return make_node(self.kind, **{**self.case.settings, **settings})

    def reading(self, t):
        """The feeding of what is heard of joint 1, and that at t [ns]."""
        sample = next(s for s in self.samples if s.stream == 1)
        topic, content = message(sample._replace(t=t))
        return next(i.feed for i in self.kind.inputs(self.settings, 4) if i.topic == topic), content

    def set_clock_back(self, node):
        """Let the clock of joint 1 jump back by more than 10 s."""
        end = self.samples[-1].t
        for t in (end, end + 2 * SECOND, end - 20 * SECOND):  # the first counts once confirmed
            node.on_sample(*self.reading(t))


@pytest.fixture(scope="module", params=KINDS)
def made(request, tmp_path_factory):
    return Made(CASES[request.param], KINDS[request.param], tmp_path_factory.mktemp("made"))


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """For what is the same of all kinds: it is solved at once."""
    return Made(CASES["kinematic"], TOY, tmp_path_factory.mktemp("toy"))


@pytest.fixture(autouse=True)
def toy_in_the_table(monkeypatch):
    monkeypatch.setitem(KINDS, "toy", TOY)


@pytest.fixture
def kept(ros):
    """kept(made, **settings): a node, destroyed after the test."""
    nodes = []

    def make(made, **settings):
        nodes.append(made.node(**settings))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def test_live_is_what_the_bag_says_and_can_be_recomputed(spin, made, tmp_path, capsys):
    kind, case = made.kind, made.case
    output, report = tmp_path / "new" / "output.yaml", tmp_path / "report"
    bed, node = Bed(kind), made.node(output=str(output), report=str(report))
    play(spin, bed, node, made.samples)
    answer = ask(spin, bed, node, bed.solver)
    assert answer.success, answer.message
    spin([bed, node], lambda: bed.found() == case.count and bed.results)
    spin([bed, node], lambda: calibration_part(bed.results[-1]).used == case.count)
    result, data = bed.results[-1], bed.data[-1]
    found = calibration_part(result)
    assert (found.kind, found.verdict, found.provenance.source) == (kind.name, "pass", "live")
    assert result.header.frame_id if hasattr(result, "header") else found.header.frame_id
    assert data.header.frame_id == found.header.frame_id == (kind.frame or "fss")
    assert list(found.names) == list(made.outcome.names)

    assert found.provenance.data_hash == made.outcome.provenance.data_hash
    np.testing.assert_allclose(found.values, made.outcome.values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.covariance, made.outcome.covariance.ravel(), rtol=1e-9)
    capsys.readouterr()
    assert recompute([recorded(tmp_path / "told", kind, (data, result))]) == 0
    assert "pass: the same" in capsys.readouterr().out
    assert recalibrate(kind, result, data).description == found.description
    assert output.read_text().partition("\n")[2] == kind.output(node.outcome).partition("\n")[2]
    assert output.with_suffix(".urdf").exists() == kind.has_urdf
    page = (report / "index.html").read_text()
    assert '<span class="pass">' in page
    for what, why in kind.unavailable.items():
        assert what in page
        assert why in page


def test_one_that_fails_says_where_its_cause_is_looked_for(kept, made):
    node = kept(made)
    failed = Check("fit", FAIL, 9.0, 1.0, "too large")
    node.solve = lambda: replace(made.outcome, checks=(failed,))
    response = node.on_solve(Trigger.Request(), Trigger.Response())
    assert not response.success
    looks = "; to find the cause, run from_bag on a recording"
    assert response.message == "fail: too large" + looks * (CAUSES not in made.kind.unavailable)


def test_the_likely_cause_is_named_from_three_observations_on(kept, toy):
    def wrong(one):
        return replace(one, q=(one.q[0], -one.q[1], *one.q[2:]))

    node = kept(toy)
    reversed_joint = [wrong(one) for one in toy.outcome.data]
    node.add_data(reversed_joint[:2])
    assert "wrong sign" not in node.outcome.reason
    node.add_data(reversed_joint[2:5])
    assert node.outcome.reasons[0].startswith("joint_2 with the wrong sign? reversed, ")
    problem = node.kind.problem(node.outcome, Streams(), node.settings)
    assert problem == node.outcome.reasons[0]
    node.add_data(reversed_joint[5:])
    assert node.outcome.verdict == FAIL
    answer = node.on_solve(Trigger.Request(), Trigger.Response())
    assert answer.message.startswith("fail: joint_2 with the wrong sign? reversed, ")
    assert "from_bag" not in answer.message


def test_a_failed_result_is_published_and_not_written_over_a_good_one(kept, toy, tmp_path):
    good = tmp_path / "good.yaml"
    good.write_text("good")
    node = kept(toy, output=str(good), **POOR)
    node.add_data(toy.outcome.data)
    assert node.outcome.verdict == FAIL
    assert node.outcome.description == ""
    assert good.read_text() == "good"


def test_a_node_that_was_killed_goes_on(spin, kept, made, tmp_path):
    files = {"state_file": str(tmp_path / "state.json")}
    first, data = kept(made, **files), list(made.outcome.data)
    first.data = data
    first.save()
    bed, second = Bed(made.kind), kept(made, **files)
    assert second.data == data
    assert second.outcome.verdict == PASS
    spin([bed, second], lambda: bed.found() == len(data) and bed.results)
    np.testing.assert_allclose(second.outcome.values, made.outcome.values, rtol=0, atol=1e-12)


def test_a_state_file_of_another_kind_or_arm_is_named(kept, toy, tmp_path):
    state = tmp_path / "state.json"
    kept(toy, state_file=str(state)).add_data(toy.outcome.data)
    saved = json.loads(state.read_text())
    spoilt = {"data": [{**one, "q": []} for one in saved["data"]]}
    for change, words in (
        ({"kind": "other"}, "kind is 'other', expected "),
        ({"joints": 5}, "joints is 5, expected 4"),
        (spoilt, "the saved data cannot be solved"),
    ):
        state.write_text(json.dumps({**saved, **change}))
        with pytest.raises(StateError, match=words) as caught:
            kept(toy, state_file=str(state))
        assert str(state) in str(caught.value)


def test_a_clock_that_ran_back_is_remembered_until_all_is_forgotten(kept, toy, tmp_path):
    """Else a restart would make of it a result that passes, and write it."""
    state, output, data = tmp_path / "state.json", tmp_path / "output.yaml", toy.outcome.data
    files = {"state_file": str(state), "output": str(output)}
    first = kept(toy, **files)
    toy.set_clock_back(first)
    first.health()  # as diagnostics ask: no datum needs to come after it
    assert json.loads(state.read_text())["flags"]["set_back"]["joint_1"] > 10.0
    first.add_data(data)
    second = kept(toy, **files)
    assert second.data == list(data)
    assert second.outcome.verdict == NOT_EVALUATED
    assert "clock of joint_1 jumped back by" in second.outcome.reason
    second.add_data(data[:1])
    third = kept(toy, **files)
    assert third.outcome.verdict == NOT_EVALUATED
    assert not output.exists()
    answer = third.on_forget(Trigger.Request(), Trigger.Response())
    assert answer.message == "9 observations forgotten"
    assert json.loads(state.read_text())["data"] == third.data == []
    assert third.outcome.verdict == NOT_EVALUATED
    third.add_data(data)
    assert third.outcome.verdict == PASS
    assert output.exists()


def test_older_data_go_and_what_is_rejected_takes_no_place(kept, toy):
    most = toy.case.count - 1
    node, data = kept(toy, max_observations=most), list(toy.outcome.data)
    node.add_data(data[:1])
    node.add_data(data[1:])
    assert node.data == data[1:]
    node.add_data([replace(data[0], used=False, reason="a gap")] * (most + 2))
    assert node.data[:most] == data[1:]
    assert len(node.data) == 2 * most
    offline = solve_bag(toy.kind, toy.bag, replace(toy.settings, max_observations=most))
    assert offline.provenance.data_hash == node.outcome.provenance.data_hash


def test_data_are_numbered_in_the_log_also_after_the_oldest_are_dropped(
    kept, toy, tmp_path, monkeypatch
):
    lines = []
    monkeypatch.setattr(RcutilsLogger, "info", lambda _, text: lines.append(text))

    def numbers(node, found):
        lines.clear()
        node.add_data(found)
        return [int(line.split()[1][:-1]) for line in lines if line.startswith("observation ")]

    data, files = list(toy.outcome.data), {"state_file": str(tmp_path / "state.json")}
    node = kept(toy, max_observations=3, **files)
    assert numbers(node, data[:2]) == [1, 2]
    assert numbers(node, data[2:7]) == [3, 4, 5, 6, 7]  # more than are kept
    assert numbers(node, data[7:8]) == [8]
    assert numbers(kept(toy, max_observations=3, **files), data[:1]) == [4]  # after the three kept
    node.on_forget(Trigger.Request(), Trigger.Response())
    assert numbers(node, data[:1]) == [1]


def test_what_cannot_be_written_is_told_and_nothing_else_is_lost(kept, toy, tmp_path):
    out, state = tmp_path / "new" / "out.yaml", tmp_path / "kept" / "state.json"
    node = kept(toy, output=str(out), state_file=str(state))
    (tmp_path / "kept").write_text("in the way")
    node.add_data(toy.outcome.data)
    assert out.exists()
    assert node.health().level == ERROR
    assert node.health().message.startswith(f"cannot write {tmp_path}")
    (tmp_path / "kept").unlink()
    node.publish()
    assert node.health().level != ERROR
    assert len(json.loads(state.read_text())["data"]) == toy.case.count


def hear(node, made):
    """Give a node the samples of the first 2 s."""
    inputs = {one.topic: one.feed for one in made.kind.inputs(made.settings, 4)}
    heard = [s for s in made.samples if s.t < made.samples[0].t + 2 * SECOND]
    for topic, content in map(message, heard):
        if topic in inputs:
            node.on_sample(inputs[topic], content)
    return heard


def test_silent_streams_and_unknown_joints_are_named(kept, made):
    node, kind = kept(made), made.kind
    health = node.health()
    assert (health.level, node.outcome.verdict) == (WARN, NOT_EVALUATED)
    streams = [f"{made.case.streams}_{i}" for i in range(1, 5)]
    assert health.message.startswith(f"waiting for {', '.join(streams)}")
    assert ("fss" in health.message) == (kind is not DRIVES)
    heard = hear(node, made)
    assert node.health().level == OK
    if kind is DRIVES:
        return
    feed, reading = made.reading(heard[-1].t)
    reading.name = ["joint_9"]
    node.on_sample(feed, reading)
    assert node.health().message == "the arm has no joint_9"
    node.add_data(made.outcome.data)
    assert node.outcome.verdict == NOT_EVALUATED
    assert "received joint_9, but 'paper' has 4 joints" in node.outcome.reason


def test_a_clock_that_ran_back_is_named(kept, made):
    node, back = kept(made), f"clock of {made.case.streams}_1 jumped back by"
    hear(node, made)
    made.set_clock_back(node)
    health = node.health()
    assert health.level == WARN
    assert back in health.message
    said = f"(at most {node.settings.joint_gap:g}): call {made.kind.name}/forget to reset"
    assert health.message.endswith(said)
    node.add_data(made.outcome.data)
    assert node.outcome.verdict == NOT_EVALUATED
    assert back in node.outcome.reason


def test_node_and_command_have_the_same_settings(kept, made):
    node, kind = kept(made), made.kind
    options = parser(kind).parse_args(["bag"])
    for f in fields(kind.settings):
        assert getattr(options, f.name) == f.default
        want = made.case.settings.get(f.name, f.default)
        assert node.get_parameter(f.name).value == want
    own = {f.name for f in fields(node_settings(kind.name, kind.settings))}
    assert own >= {"frame_id", "state_file", "output", "report"}
    assert kind.max_data(replace(made.settings, **{made.case.most: 7})) == 7


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"arm": "/nowhere/arm.yaml"}, "/nowhere/arm.yaml"),
        ({"still": 1.0}, "no parameter still; there are"),
    ],
)
def test_impossible_parameters_are_refused(ros, toy, settings, message):
    with pytest.raises((ValueError, OSError), match=message):
        toy.node(**settings)


def test_the_command_for_bags(made, tmp_path, capsys):
    kind, output, page = made.kind, tmp_path / "found.yaml", tmp_path / "report"
    flag = [] if kind.name == "kinematic" else [f"--{kind.name}"]
    given = [f"--{k.replace('_', '-')}={v}" for k, v in made.case.settings.items()]
    files = "--output", str(output), "--report", str(page)
    assert from_bag([*flag, str(made.bag), *given, *files]) == 0
    assert f"{kind.output_name} written to {output}" in capsys.readouterr().out
    assert output.exists()
    if kind.has_urdf:
        assert output.with_suffix(".urdf").read_text() == urdf(load(output))
    assert "pass" in (page / "index.html").read_text()


def test_the_command_writes_nothing_of_what_fails(toy, tmp_path, capsys):
    asked = [f"--{name.replace('_', '-')}={value}" for name, value in POOR.items()]
    assert from_bag(["--toy", str(toy.bag), *asked, "--output", str(tmp_path / "no")]) == 2
    assert "not written, as the verdict is fail" in capsys.readouterr().out
    assert not (tmp_path / "no").exists()
