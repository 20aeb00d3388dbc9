"""What the calibrations of all kinds have alike: node, state, bag, recomputation, report."""

import json
from dataclasses import fields, replace
from functools import cached_property

import numpy as np
import pytest
from calib_kinds import CASES, Bed, ask, kind_of, make_node, play, serialized
from calib_toy import TOY
from std_srvs.srv import Trigger

from fss_arm_bags.recorder import Recording
from fss_arm_calib.acceptance import FAIL, Check
from fss_arm_calib.calibration import CAUSES
from fss_arm_calib.drives.kind import DRIVES
from fss_arm_calib.from_bag import EXIT_CODES, solve_bag
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag_options import parser
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.messages import calibration_part
from fss_arm_calib.node_settings import node_settings
from fss_arm_calib.recompute import main as recompute_command
from fss_arm_calib.recompute import recalibrate, recompute
from fss_arm_calib.state import StateError
from fss_arm_model.description_file import load
from fss_arm_model.urdf import urdf
from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN
from fss_arm_ros.qos import LATCHED

assert CASES.keys() == {*KINDS, "toy"}


class Made:
    """A kind with its samples, its bag, and what comes of it; each made once."""

    def __init__(self, case, folder):
        self.case, self.kind = case, kind_of(case)
        self.samples, self.folder = case.samples(), folder
        self.settings = self.kind.settings(**case.settings)

    @cached_property
    def bag(self):
        return self.case.module.record(self.folder / "bag", self.samples)

    @cached_property
    def outcome(self):
        return solve_bag(self.kind, self.bag, self.settings)

    def node(self, **settings):
        return make_node(self.kind, **{**self.case.settings, **settings})

    def reading(self, t):
        """The feeding of what is heard of joint 1, and that at t [ns]."""
        sample = next(s for s in self.samples if s.stream == 1)
        topic, message = self.case.module.message(sample._replace(t=t))
        return next(i.feed for i in self.kind.inputs(self.settings, 4) if i.topic == topic), message


@pytest.fixture(scope="module", params=CASES)
def made(request, tmp_path_factory):
    return Made(CASES[request.param], tmp_path_factory.mktemp(request.param))


@pytest.fixture(autouse=True)
def toy_in_the_table(monkeypatch):
    """A kind more: a record in the table is all that it takes."""
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


def test_live_is_what_the_bag_says_and_can_be_recomputed(spin, made, tmp_path):
    kind, case = made.kind, made.case
    output, report = tmp_path / "new" / "output.yaml", tmp_path / "report"
    bed, node = Bed(kind), made.node(output=str(output), report=str(report))
    play(spin, bed, node, made.samples, case.module.message)
    answer = ask(spin, bed, node, bed.solver)
    assert answer.success, answer.message
    spin([bed, node], lambda: bed.found() == case.count and bed.results)
    spin([bed, node], lambda: calibration_part(bed.results[-1]).used == case.count)
    result, data = bed.results[-1], bed.data[-1]
    found = calibration_part(result)
    assert (found.kind, found.verdict, found.provenance.source) == (kind.name, "pass", "live")
    assert result.header.frame_id if hasattr(result, "header") else found.header.frame_id
    assert data.header.frame_id == found.header.frame_id == kind.frame
    assert list(found.names) == list(made.outcome.names)

    assert found.provenance.data_hash == made.outcome.provenance.data_hash
    np.testing.assert_allclose(found.values, made.outcome.values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.covariance, made.outcome.covariance.ravel(), rtol=1e-9)
    assert recompute(kind, result, data).same
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


def test_each_datum_comes_back_from_its_message(made):
    data = made.kind.data
    assert list(made.outcome.data) == data.from_message(data.to_message(made.outcome.data, "fss"))
    unused = [replace(one, used=False, reason="a gap") for one in made.outcome.data]
    assert data.from_message(data.to_message(unused, "fss")) == unused


def test_too_little_is_not_evaluated(kept, made):
    node = kept(made)
    assert node.outcome.verdict == "not_evaluated"
    assert np.isnan(node.outcome.values).all()
    assert np.isnan(node.outcome.covariance).all()
    message = calibration_part(made.kind.to_message(node.outcome, "fss"))
    assert message.description == ""
    assert list(message.residuals) == list(message.weights) == []


def test_a_failed_result_is_published_and_not_written_over_a_good_one(kept, made, tmp_path):
    good = tmp_path / "good.yaml"
    good.write_text("good")
    node = kept(made, output=str(good), **made.case.asked)
    node.add_data(made.outcome.data)
    assert node.outcome.verdict == made.case.unmet, node.outcome.reason
    assert node.outcome.description == ""
    assert good.read_text() == "good"


def test_a_node_that_was_killed_goes_on(spin, made, tmp_path):
    state, data = tmp_path / "state.json", made.outcome.data
    first = made.node(state_file=str(state))
    first.add_data(data[:-1])
    first.add_data(data[-1:])
    then = first.outcome
    first.destroy_node()
    bed, second = Bed(made.kind), made.node(state_file=str(state))
    assert second.data == list(data)
    assert second.outcome.verdict == then.verdict == "pass"
    np.testing.assert_array_equal(second.outcome.values, then.values)
    spin([bed, second], lambda: bed.found() == len(data) and bed.results)


def test_a_state_file_of_another_kind_or_arm_is_named(kept, made, tmp_path):
    state = tmp_path / "state.json"
    kept(made, state_file=str(state)).add_data(made.outcome.data)
    saved = json.loads(state.read_text())
    for change, message in (
        ({"kind": "other"}, "kind is 'other', expected "),
        ({"joints": 5}, "joints is 5, expected 4"),
        (
            {"data": [{**one, made.case.lacking: []} for one in saved["data"]]},
            "the saved data cannot be solved",
        ),
    ):
        state.write_text(json.dumps({**saved, **change}))
        with pytest.raises(StateError, match=message) as caught:
            kept(made, state_file=str(state))
        assert str(state) in str(caught.value)


def test_what_is_forgotten_is_gone_and_it_begins_anew(spin, made, tmp_path):
    """A clock runs back by 10 s, which no datum after it would mend."""
    state, output = tmp_path / "state.json", tmp_path / "output.yaml"
    bed, node = Bed(made.kind), made.node(state_file=str(state))
    some = [s for s in made.samples if s.t < made.samples[0].t + 12_000_000_000]
    play(spin, bed, node, some, made.case.module.message)
    node.add_data(made.outcome.data)
    feed, reading = made.reading(some[-1].t - 10_000_000_000)
    node.on_sample(feed, reading)
    said = f"(at most {node.settings.joint_gap:g}): call {made.kind.name}/forget to reset"
    assert node.health().level == WARN
    assert f"clock of {made.case.streams}_1 jumped back by" in node.health().message
    assert node.health().message.endswith(said)
    assert node.data
    answer = ask(spin, bed, node, bed.forgetter)
    assert answer.success
    assert answer.message.endswith("forgotten")
    spin([bed, node], lambda: bed.found() == 0)
    assert json.loads(state.read_text())["data"] == []
    assert node.outcome.verdict == "not_evaluated"
    node.add_data(made.outcome.data)
    assert node.outcome.verdict == "pass"
    assert "ran back" not in node.health().message
    assert not output.exists()


def test_a_clock_that_ran_back_is_remembered_across_restarts(kept, made, tmp_path):
    """Else a restart would make of it a result that passes, and write it."""
    state, output = tmp_path / "state.json", tmp_path / "output.yaml"
    files = {"state_file": str(state), "output": str(output)}
    first = kept(made, **files)
    end, name = made.samples[-1].t, f"{made.case.streams}_1"
    for at in (end, end + 2 * SECOND, end - 20 * SECOND):  # the first counts once confirmed
        first.on_sample(*made.reading(at))
    first.health()  # as diagnostics ask: no datum needs to come after it
    assert json.loads(state.read_text())["flags"]["set_back"][name] > 10.0
    first.add_data(made.outcome.data)
    assert first.outcome.verdict == "not_evaluated"
    second = kept(made, **files)
    assert second.data == list(made.outcome.data)
    assert second.outcome.verdict == "not_evaluated"
    assert f"clock of {name} jumped back by" in second.outcome.reason
    second.add_data(made.outcome.data[:1])
    assert not output.exists()
    third = kept(made, **files)
    assert third.outcome.verdict == "not_evaluated"
    third.on_forget(Trigger.Request(), Trigger.Response())
    third.add_data(made.outcome.data)
    assert third.outcome.verdict == "pass"
    assert output.exists()


def test_older_data_go_and_what_is_rejected_takes_no_place(kept, made):
    most = made.case.count - 1
    node, data = kept(made, **{made.case.most: most}), list(made.outcome.data)
    node.add_data(data[:1])
    node.add_data(data[1:])
    assert node.data == data[1:]
    node.add_data([replace(data[0], used=False, reason="a gap")] * (most + 2))
    assert node.data[:most] == data[1:]
    assert len(node.data) == 2 * most
    settings = replace(made.settings, **{made.case.most: most})
    offline = solve_bag(made.kind, made.bag, settings)
    assert offline.provenance.data_hash == node.outcome.provenance.data_hash


def test_what_cannot_be_written_is_told_and_nothing_else_is_lost(kept, made, tmp_path):
    out, state = tmp_path / "new" / "out.yaml", tmp_path / "kept" / "state.json"
    node = kept(made, output=str(out), state_file=str(state))
    (tmp_path / "kept").write_text("in the way")
    node.add_data(made.outcome.data)
    assert out.exists()
    assert node.health().level == ERROR
    assert node.health().message.startswith(f"cannot write {tmp_path}")
    (tmp_path / "kept").unlink()
    node.publish()
    assert node.health().level != ERROR
    assert len(json.loads(state.read_text())["data"]) == made.case.count


def test_silent_streams_and_unknown_joints_are_named(kept, made):
    node = kept(made)
    health = node.health()
    assert health.level == WARN
    streams = [f"{made.case.streams}_{i}" for i in range(1, 5)]
    assert health.message.startswith(f"waiting for {', '.join(streams)}")
    assert ("fss" in health.message) == (made.kind is not DRIVES)
    heard = [s for s in made.samples if s.t < made.samples[0].t + 2 * SECOND]
    inputs = {one.topic: one.feed for one in made.kind.inputs(made.settings, 4)}
    for topic, message in map(made.case.module.message, heard):
        if topic in inputs:
            node.on_sample(inputs[topic], message)
    assert node.health().level == OK
    if made.kind is DRIVES:
        return
    feed, reading = made.reading(heard[-1].t)
    reading.name = ["joint_9"]
    node.on_sample(feed, reading)
    assert node.health().message == "the arm has no joint_9"
    node.add_data(made.outcome.data)
    assert node.outcome.verdict == "not_evaluated"
    assert "received joint_9, but 'paper' has 4 joints" in node.outcome.reason


def test_a_robust_loss_weighs_and_an_outlier_is_rejected_by_choice(kept, made):
    """Each kind but the toy, which is no more than a mean, and one that has none."""
    if made.kind is TOY or "weight or outlier" in made.kind.unavailable:
        return
    node = kept(made, loss="huber", max_outliers=1)
    node.add_data(made.outcome.data)
    e = node.outcome.estimate
    assert len(e.weights) == len(e.errors) == len(e.reasons) == len(e.leverage) == made.case.count
    assert ((e.weights > 0.0) & (e.weights <= 1.0)).all()
    assert {"outliers", "redundancy", "determined", "convergence", "fit", "clocks"} <= {
        check.name for check in node.outcome.checks
    }


def test_node_and_command_have_the_same_settings(kept, made):
    node = kept(made)
    options = parser(made.kind).parse_args(["bag"])
    for f in fields(made.kind.settings):
        assert getattr(options, f.name) == f.default
        want = made.case.settings.get(f.name, f.default)
        assert node.get_parameter(f.name).value == want
    assert {f.name for f in fields(node_settings(made.kind.name, made.kind.settings))} >= {
        "frame_id",
        "state_file",
        "output",
        "report",
    }


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"arm": "/nowhere/arm.yaml"}, "/nowhere/arm.yaml"),
        ({"still": 1.0}, "no parameter still; there are"),
    ],
)
def test_impossible_parameters_are_refused(ros, made, settings, message):
    with pytest.raises((ValueError, OSError), match=message):
        made.node(**settings)


def test_a_recorded_result_is_computed_again(made, tmp_path, capsys):
    kind, outcome, bag = made.kind, made.outcome, Recording(tmp_path)
    for stamp, topic, message in (
        (1, kind.data.topic, kind.data.to_message(outcome.data, "fss")),
        (2, kind.topic, kind.to_message(outcome, "fss")),
    ):
        bag.add(f"/{topic}", f"fss_arm_msgs/msg/{type(message).__name__}", [LATCHED])
        bag.write(f"/{topic}", stamp, serialized(message))
    bag.close()
    assert recompute_command([str(bag.path)]) == 0
    assert f"{made.case.count} {kind.data.noun}s, pass: the same" in capsys.readouterr().out


def test_the_command_for_bags(made, tmp_path, capsys):
    bag, output, page = str(made.bag), tmp_path / "found.yaml", tmp_path / "report"
    flag = [] if made.kind.name == "kinematic" else [f"--{made.kind.name}"]
    given = [f"--{k.replace('_', '-')}={v}" for k, v in made.case.settings.items()]
    assert from_bag([*flag, bag, *given, "--output", str(output), "--report", str(page)]) == 0
    text = capsys.readouterr().out
    assert f"{made.kind.output_name} written to {output}" in text
    assert output.exists()
    if made.kind.has_urdf:
        assert output.with_suffix(".urdf").read_text() == urdf(load(output))
    assert "pass" in (page / "index.html").read_text()
    asked = [f"--{k.replace('_', '-')}={v}" for k, v in made.case.asked.items()]
    no = tmp_path / "no.yaml"
    code = EXIT_CODES[made.case.unmet]
    assert from_bag([*flag, bag, *given, *asked, "--output", str(no)]) == code
    assert f"not written, as the verdict is {made.case.unmet}" in capsys.readouterr().out
    assert not no.exists()


def test_the_help_tells_what_a_kind_lacks(made, capsys):
    with pytest.raises(SystemExit):
        from_bag([f"--{made.kind.name}", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    for what, why in made.kind.unavailable.items():
        assert f"No {what}: {why}." in said
