"""The node on real topics, the same data from a bag, and both against each other."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from calib_rig import ARM, TYPES, Rig, Sample, at, message, record
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from fss_arm_bags.reader import BagError
from fss_arm_bags.recording import Recording
from fss_arm_bags.replay_node import ReplayNode
from fss_arm_calib.acceptance import settings_of
from fss_arm_calib.experiment.postures import DEFAULT
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import parser, solve_bag
from fss_arm_calib.kinematic.checks import calibrate
from fss_arm_calib.kinematic.problem import FULL, KinematicProblem, quantization_bound, solve
from fss_arm_calib.kinematic.settings import CalibrationSettings
from fss_arm_calib.kinematic_node import KinematicNode
from fss_arm_calib.messages import observations_of, to_message
from fss_arm_calib.segments.rests import TIP, Observation
from fss_arm_model.description import from_yaml, load, paper_arm, save
from fss_arm_model.kinematics import tip_in_base
from fss_arm_msgs.msg import KinematicCalibration, KinematicObservations, LinkTelemetry
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.diagnostics import ERROR, OK, WARN
from fss_arm_ros.qos import LATCHED, SENSOR, sensor


class Bed(Node):
    """Publishes a rig's samples, and hears what the calibration says."""

    def __init__(self):
        super().__init__("bed")
        self.outputs = {
            topic: self.create_publisher(kind, topic, sensor(keep_all=True))
            for topic, kind in TYPES.items()
        }
        self.observations, self.results = [], []
        self.create_subscription(
            KinematicObservations, "calibration/observations", self.observations.append, LATCHED
        )
        self.create_subscription(
            KinematicCalibration, "calibration/kinematic", self.results.append, LATCHED
        )
        self.solver = self.create_client(Trigger, "kinematic/solve")
        self.forgetter = self.create_client(Trigger, "kinematic/forget")

    def ready(self):
        return self.solver.service_is_ready() and all(
            p.get_subscription_count() for p in self.outputs.values()
        )

    def observed(self):
        """Number of observations in the last message heard."""
        return len(self.observations[-1].observations) if self.observations else 0


def make_node(**settings):
    return KinematicNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])


@pytest.fixture
def play(spin):
    """play(bed, node, samples): publish them as fast as the node hears them."""

    def run(bed, node, samples):
        spin([bed, node], bed.ready)
        heard = node.finder
        for k, sample in enumerate(samples, 1):
            topic, content = message(sample)
            bed.outputs[topic].publish(content)
            if k % 100 == 0:
                spin([bed, node], lambda: True)
        newest = {s.stream: s.t for s in samples}
        spin(
            [bed, node],
            lambda: all(
                (heard.subjects[s] if isinstance(s, str) else heard.joints[s - 1]).newest >= t
                for s, t in newest.items()
            ),
            30.0,
        )

    return run


def ask_to_solve(spin, bed, node):
    answer = bed.solver.call_async(Trigger.Request())
    return spin([bed, node], lambda: answer.done() and answer.result())


@pytest.fixture(scope="module")
def samples():
    """Eight postures of the default list, VICON at 50 Hz."""
    return Rig(DEFAULT[:8], rest=3.2, rate=50.0).samples(lag=3_000_000)


def test_live_solution_is_the_truth_and_can_be_recomputed(spin, play, samples, tmp_path):
    bed = Bed()
    save(paper_arm(), tmp_path / "guess.yaml")
    node = make_node(arm=str(tmp_path / "guess.yaml"), output=str(tmp_path / "found.yaml"))
    play(bed, node, samples)
    answer = ask_to_solve(spin, bed, node)
    assert answer.success, answer.message
    result = spin([bed, node], lambda: bed.observed() == 8 and bed.results and bed.results[-1])
    assert result.verdict == "pass"
    assert result.header.frame_id == bed.observations[-1].header.frame_id == "fss"
    assert result.observations_used == 8

    # to what the encoder's counts allow
    known = result.parametrization, result.position_deviation, result.heading_deviation
    q, tip = np.reshape(result.q, (-1, 4)), np.reshape(result.tip, (-1, 3))
    problem = KinematicProblem(q, tip, ARM, *known)
    bound = quantization_bound(problem, np.pi / 240_000)
    assert np.all(np.abs(np.array(result.values) - problem.initial) <= 1.001 * bound)
    assert load(tmp_path / "found.yaml").links[0].a == result.values[0]

    # the observations published are those used, and give the result again
    observations = bed.observations[-1].observations
    assert np.array_equal([o.q for o in observations], q)
    assert np.array_equal([o.tip for o in observations], tip)
    again = solve(problem)
    assert np.abs(again.values - result.values).max() < 1e-9
    assert np.abs(again.covariance.ravel() - result.covariance).max() < 1e-9
    assert np.abs(again.residuals.ravel() - result.residuals).max() < 1e-9

    # with the settings and the description that it says
    settings = settings_of(result.provenance, CalibrationSettings)
    recomputed = to_message(
        calibrate(observations_of(bed.observations[-1]), from_yaml(result.guess), settings), "fss"
    )
    assert recomputed.description == result.description
    assert recomputed.observations_hash == result.provenance.data_hash
    assert result.provenance.source == "live"
    for name in ("values", "covariance", "residuals", "leverage", "held_out_residuals"):
        assert np.abs(np.subtract(getattr(recomputed, name), getattr(result, name))).max() < 1e-9
    assert [s.reason for s in recomputed.stages] == [s.reason for s in result.stages]

    # and so does a bag of the same topics
    offline = to_message(solve_bag(record(tmp_path / "bags", samples)), "fss")
    assert offline.observations_hash == result.observations_hash
    assert np.abs(np.array(offline.values) - result.values).max() < 1e-9


def test_a_failed_result_is_published_and_not_written_over_a_good_one(spin, tmp_path):
    good = tmp_path / "good.yaml"
    save(paper_arm(), good)
    bed, node = Bed(), make_node(output=str(good), heading_deviation=1e-6, position_deviation=1e-6)
    spin([bed, node], bed.solver.service_is_ready)
    tips = tip_in_base(ARM.vector(), DEFAULT) + [0.001, 0.0, 0.0] * np.arange(13)[:, None]
    found = [
        Observation(at(k), at(k + 1), tuple(q), tuple(tip))
        for k, (q, tip) in enumerate(zip(DEFAULT.tolist(), tips.tolist(), strict=True))
    ]
    node.take(found)
    result = spin([bed, node], lambda: bed.observed() == 13 and bed.results and bed.results[-1])
    assert result.verdict == "fail"
    assert result.description == ""
    assert "fail" in [stage.verdict for stage in result.stages]
    assert load(good) == paper_arm()


def test_an_observation_is_published_during_the_rest_and_the_verdict_says_what_lacks(
    spin, play, samples
):
    bed, node = Bed(), make_node(parametrization=FULL)
    play(bed, node, [s for s in samples if s.t < at(3.1)])
    result = spin([bed, node], lambda: bed.results and bed.results[-1])
    assert bed.observed() == 1
    assert result.verdict == "not_evaluated"
    assert result.reason.startswith("1 observation, at least 6 needed for a_1, a_2, a_3, a_4")
    assert np.isnan(result.values).all()
    assert list(result.covariance) == list(result.residuals) == []
    assert result.description == ""


def test_solve_closes_the_last_rest(spin, play, samples):
    bed, node = Bed(), make_node()
    play(bed, node, [s for s in samples if s.t < at(2.0)])
    assert bed.observed() == 0
    answer = ask_to_solve(spin, bed, node)
    assert not answer.success
    assert "not_evaluated: 1 observation" in answer.message
    spin([bed, node], lambda: bed.observed() == 1)


def test_a_node_that_was_killed_goes_on(spin, play, samples, tmp_path):
    bed, state = Bed(), str(tmp_path / "state.json")
    first = make_node(state_file=state)
    play(bed, first, [s for s in samples if s.t < at(19.0)])
    spin([bed, first], lambda: bed.observed() == 4)
    first.executor.remove_node(first)
    first.destroy_node()
    spin([bed], lambda: not bed.solver.service_is_ready())
    bed.observations.clear()
    second = make_node(state_file=state)
    spin([bed, second], lambda: bed.observed() == 4)
    # Posture 4 rests until 18.8 s: the rest that the first has observed is not observed again.
    play(bed, second, [s for s in samples if s.t >= at(16.5)])
    spin([bed, second], lambda: bed.observed() == 8)
    assert len(json.loads((tmp_path / "state.json").read_text())) == 8


def test_older_rests_go(spin, play, samples, tmp_path):
    bed, node = Bed(), make_node(kept=6)
    play(bed, node, samples)
    assert ask_to_solve(spin, bed, node).success
    spin([bed, node], lambda: bed.observed() == 6 and len(node.observations) == 6)
    offline = solve_bag(record(tmp_path, samples), CalibrationSettings(kept=6))
    assert offline.observations_hash == bed.results[-1].observations_hash
    assert np.abs(offline.q - DEFAULT[2:8]).max() < 1e-4


def test_what_is_spoiled_takes_no_place_of_what_is_used(ros):
    node = make_node(kept=6)
    tips = tip_in_base(ARM.vector(), DEFAULT)
    used = [
        Observation(at(k), at(k + 1), tuple(q), tuple(tip))
        for k, (q, tip) in enumerate(zip(DEFAULT.tolist(), tips.tolist(), strict=True))
    ]
    node.take(used)
    node.take([replace(used[0], used=False, reason="a gap")] * 10)
    assert node.observations[:6] == used[-6:]
    assert len(node.observations) == 12
    node.destroy_node()


def test_what_cannot_be_written_is_told_and_nothing_else_is_lost(spin, play, samples, tmp_path):
    out, state = tmp_path / "new" / "arm.yaml", tmp_path / "state.json"
    (tmp_path / ".state.json.part").mkdir()  # in the way
    (tmp_path / "report").write_text("in the way")
    settings = {"output": str(out), "state_file": str(state), "report": str(tmp_path / "report")}
    bed, node = Bed(), make_node(**settings)
    play(bed, node, samples)
    assert ask_to_solve(spin, bed, node).success
    spin([bed, node], lambda: bed.observed() == 8)
    assert load(out).links[0].a > 0.0  # its folder was made
    assert node.health().level == ERROR
    assert node.health().message.startswith(f"cannot write {tmp_path}")
    (tmp_path / ".state.json.part").rmdir()
    (tmp_path / "report").unlink()
    assert ask_to_solve(spin, bed, node).success
    assert node.health().level == OK
    assert len(json.loads(state.read_text())) == 8


def reference(i, seconds, homings):
    message = LinkTelemetry(link=i, boot=3, homings=homings)
    message.header.stamp = to_time(at(seconds))
    return message


def test_a_link_homed_later_asks_for_its_offsets(spin, play, samples):
    bed, node = Bed(), make_node()
    link = bed.create_publisher(LinkTelemetry, "link_2/telemetry", 10)
    spin([bed, node], link.get_subscription_count)
    link.publish(reference(2, 0.0, 1))
    play(bed, node, samples)
    assert ask_to_solve(spin, bed, node).success
    result = spin([bed, node], lambda: bed.observed() == 8 and bed.results[-1])
    assert list(result.boots) == [0, 3, 0, 0]
    assert list(result.homings) == [0, 1, 0, 0]
    assert node.health().message == "8 observations"
    link.publish(reference(2, 100.0, 2))
    said = "joint_2 homed or restarted since: calibrate the offsets"
    spin([bed, node], lambda: node.health().message == said)


def test_what_is_forgotten_is_gone_and_it_begins_anew(spin, play, samples, tmp_path):
    """A clock runs back by 10 s, which no observation after it would mend."""
    bed, node = Bed(), make_node(state_file=str(tmp_path / "state.json"))
    link = bed.create_publisher(LinkTelemetry, "link_2/telemetry", 10)
    spin([bed, node], link.get_subscription_count)
    play(bed, node, [s for s in samples if s.t < at(9.0)])
    assert bed.observed() == 2
    bed.outputs["joint_states"].publish(message(Sample(at(-1.0), 1, 0.0))[1])
    said = "clock of joint_1 ran back by 9.83 s (at most 1): kinematic/forget begins anew"
    spin([bed, node], lambda: node.health().message == said)
    assert node.health().level == WARN
    answer = bed.forgetter.call_async(Trigger.Request())
    spin([bed, node], lambda: answer.done() and bed.observed() == 0)
    assert answer.result().success
    assert answer.result().message == "2 observations forgotten"
    assert json.loads((tmp_path / "state.json").read_text()) == []
    link.publish(reference(2, 9.0, 1))
    play(bed, node, [s for s in samples if s.t < at(9.0)])
    result = spin([bed, node], lambda: bed.observed() == 2 and bed.results[-1])
    assert list(result.homings) == [0, 1, 0, 0]
    assert "ran back" not in result.reason
    assert node.health().level == OK


def test_homings_are_read_from_bags(samples, tmp_path):
    told = Recording(tmp_path / "a")
    told.add("/link_2/telemetry", "fss_arm_msgs/msg/LinkTelemetry", [SENSOR])
    for seconds, homings in ((0.0, 1), (14.0, 2)):
        message = serialize_message(reference(2, seconds, homings))
        told.write("/link_2/telemetry", at(seconds), message)
    told.close()
    found = solve_bag([told.path, record(tmp_path / "b", samples)], CalibrationSettings())
    assert found.homings == (0, 2, 0, 0)
    assert len(found.q) == 5
    assert "3 observations left out: joint_2 homed or restarted since" in found.reason


def test_a_gap_makes_the_verdict_not_evaluated_until_the_posture_is_repeated(spin, play):
    rig = Rig(np.array([*DEFAULT[:7], DEFAULT[3]]), rest=3.2, rate=50.0)
    bed, node = Bed(), make_node()
    gap = [
        s for s in rig.samples() if s.stream != TIP or not at(15.0) < s.t < at(19.0)
    ]  # posture 4 rests from 15.6 to 18.8 s
    play(bed, node, [s for s in gap if s.t < at(36.0)])
    lacking = spin([bed, node], lambda: bed.observed() == 7 and bed.results and bed.results[-1])
    assert lacking.verdict == "not_evaluated"
    assert "1 rest spoiled (end_effector silent for" in lacking.reason
    assert lacking.gaps == 1
    play(bed, node, [s for s in gap if s.t >= at(36.0)])
    spin([bed, node], lambda: bed.observed() == 8 and bed.results[-1].verdict == "pass")


def test_a_stamp_of_another_year_and_an_endless_name_stop_nothing(spin, play, samples):
    """The stamp is rejected, first or not, also after all was forgotten; the name is no joint's."""
    bed, node = Bed(), make_node()
    spin([bed, node], bed.ready)
    year_2038 = message(Sample(2**31 * SECOND - 1, 2, 0.3))[1]
    bed.outputs["joint_states"].publish(year_2038)
    play(bed, node, [s for s in samples if s.t < at(9.0)])
    bed.outputs["joint_states"].publish(year_2038)
    play(bed, node, [s for s in samples if s.t >= at(9.0)])
    assert ask_to_solve(spin, bed, node).success
    assert node.finder.streams().refused == {"joint_2 astray in time": 2}
    bed.outputs["joint_states"].publish(year_2038)
    answer = bed.forgetter.call_async(Trigger.Request())
    spin([bed, node], lambda: answer.done() and bed.observed() == 0)
    play(bed, node, samples)
    assert ask_to_solve(spin, bed, node).success
    year_2038.name = ["joint_" + 5000 * "1"]
    bed.outputs["joint_states"].publish(year_2038)
    spin([bed, node], lambda: node.health().message == "the arm has no joint_111111111")


def test_occluded_poses_are_counted_and_harmless(spin, play, samples):
    bed, node = Bed(), make_node()
    some = [s for s in samples if s.t < at(4.0)]
    occluded = [
        s._replace(value=None) if isinstance(s.stream, str) and k % 20 == 0 else s
        for k, s in enumerate(some)
    ]
    play(bed, node, occluded)
    spin([bed, node], lambda: bed.observed() == 1)
    assert bed.observations[-1].observations[0].used
    assert sum(node.finder.streams().refused.values()) == sum(s.value is None for s in occluded)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"arm": "/nowhere/arm.yaml"}, "/nowhere/arm.yaml"),
        (
            {"parametrization": "half"},
            "parametrization is 'half', expected 'full', 'equal' or 'offsets'",
        ),
        ({"longest": 0.1}, "longest is 0.1 s, must be at least 0.5 s"),
        ({"max_condition": 0.5}, "max_condition is 0.5, must be more than 1"),
    ],
)
def test_impossible_parameters_are_refused(ros, settings, message):
    with pytest.raises((ValueError, OSError), match=message):
        make_node(**settings)


def test_the_command_for_bags(samples, tmp_path, capsys):
    bag = str(record(tmp_path / "bags", samples))
    output, page, truth = (tmp_path / name for name in ("found.yaml", "report", "truth.yaml"))
    save(paper_arm(), truth)
    asked = ["--output", str(output), "--report", str(page), "--truth", str(truth)]
    assert from_bag([bag, *asked, "--parametrization", FULL]) == 0
    text = capsys.readouterr().out
    for words in ("a_1", "theta_BJ1", "18.211", "0.683", "pass: 8 observations"):
        assert words in text
    assert load(output).links[3].a == pytest.approx(0.3351, abs=1e-4)
    assert (page / "kinematic_postures.png").read_bytes().startswith(b"\x89PNG")
    assert "pass" in (page / "index.html").read_text()

    assert from_bag([bag, "--min-observations", "9", "--output", str(tmp_path / "no.yaml")]) == 3
    assert "not written, as the verdict is not_evaluated" in capsys.readouterr().out
    assert not (tmp_path / "no.yaml").exists()

    # deviations far below what the encoder allows
    small = ["--position-deviation", "1e-7", "--heading-deviation", "1e-7"]
    assert from_bag([bag, *small]) == 2
    assert "fail: residuals are larger" in capsys.readouterr().out


def test_a_bag_with_a_gap_is_not_evaluated(samples, tmp_path, capsys):
    kept = [s for s in samples if s.stream != TIP or not at(15.0) < s.t < at(19.0)]
    assert from_bag([str(record(tmp_path, kept))]) == 3
    assert "1 rest spoiled (end_effector silent for" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["/nowhere"], "/nowhere: no such file or folder"),
        (["BAG", "--arm", "/nowhere.yaml"], "/nowhere.yaml"),
        (["BAG", "--tip-topic", "vicon/x/x"], "no /vicon/x/x in "),
        (["BAG", "--tip-topic", "joint_states"], "expected geometry_msgs/msg/PoseStamped"),
        (["BAG", "--parametrization", "half"], "parametrization is 'half'"),
        (["BAG", "--settle", "-1"], "settle is -1.0 s, must not be negative"),
        (["BAG", "--report", "/dev/null/report"], "/dev/null/report"),
        (["BAG", "--settle", "x"], "argument --settle: invalid float value: 'x'"),
        (["--dyn", "BAG"], "unrecognized arguments: --dyn"),
        ([], "the following arguments are required: BAG"),
    ],
)
def test_an_error_of_the_user_is_one_line(samples, tmp_path, capsys, args, message):
    few = [s for s in samples if s.t < at(4.0)]
    bag = str(record(tmp_path, few))
    try:
        code = from_bag([bag if a == "BAG" else a for a in args])
    except SystemExit as end:
        code = end.code
    assert code == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("from_bag: ")
    assert error.count("\n") == 1


def test_bags_are_taken_one_after_the_other(samples, tmp_path):
    whole = solve_bag(record(tmp_path / "whole", samples))
    record(tmp_path / "parts", [s for s in samples if s.t < at(20.0)])
    record(tmp_path / "parts", [s for s in samples if s.t >= at(20.0)])
    assert solve_bag(tmp_path / "parts").observations_hash == whole.observations_hash
    with pytest.raises(BagError):
        solve_bag(tmp_path)


def test_node_and_command_have_the_same_settings(ros):
    node = make_node()
    options = parser(CalibrationSettings).parse_args(["bag"])
    for f in fields(CalibrationSettings):
        assert getattr(options, f.name) == node.get_parameter(f.name).value == f.default
    node.destroy_node()


@pytest.mark.parametrize("rate", [0.0, pytest.param(15.0, marks=pytest.mark.slow)])
def test_replayed_at_any_rate_the_result_is_that_of_the_bag(spin, samples, tmp_path, rate):
    bag = record(tmp_path / "bags", samples)
    offline = to_message(solve_bag(bag), "fss")
    node = make_node()
    settings = {"rate": rate, "discovery": 0.0, "wait_for": [f"/{topic}" for topic in TYPES]}
    player = ReplayNode(
        str(bag), parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    with pytest.raises(SystemExit) as end:
        spin([player, node], lambda: False, 60.0)
    assert end.value.code == 0
    newest = {s.stream: s.t for s in samples}
    spin(node, lambda: all(p.newest == newest[s] for s, p in node.finder.subjects.items()))
    spin(node, lambda: all(j.newest == newest[i] for i, j in enumerate(node.finder.joints, 1)))
    node.take(node.finder.close())
    replayed = to_message(node.calibration, "fss")
    assert replayed.observations_hash == offline.observations_hash
    for name in ("values", "covariance", "residuals", "time_offset"):
        difference = np.subtract(getattr(replayed, name), getattr(offline, name))
        assert np.abs(difference).max() < 1e-9


def test_a_report_is_written_when_asked_to_solve(ros, tmp_path):
    node = make_node(report=str(tmp_path / "report"))
    answer = node.on_solve(Trigger.Request(), Trigger.Response())
    assert not answer.success
    assert "needed" in answer.message or "at least" in answer.message
    assert "not evaluated" in (tmp_path / "report" / "index.html").read_text()
    node.destroy_node()
