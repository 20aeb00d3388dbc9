"""The node `dynamic` and `from_bag --dynamic` on the streams of a floating arm."""

from dataclasses import fields, replace

import numpy as np
import pytest
from calib_float import ARM, TYPES, Float, at, message, postures, record
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from fss_arm_bags.recorder import Recording
from fss_arm_calib.acceptance import settings_of
from fss_arm_calib.dynamic.checks import calibrate
from fss_arm_calib.dynamic.settings import DynamicCalibrationSettings
from fss_arm_calib.dynamic_messages import maneuvers_of
from fss_arm_calib.dynamic_node import DynamicNode, DynamicSettings
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import parser, solve_dynamic_bag
from fss_arm_model.description import from_yaml, load, save
from fss_arm_msgs.msg import DynamicCalibration, LinkTelemetry, Maneuvers
from fss_arm_ros.convert import to_time
from fss_arm_ros.qos import LATCHED, SENSOR, sensor

STATE = np.array([0.1, 0.2, 3.0, 0.1, -0.1, 0.02, 0.0002, -0.0001])
PRECISE = {"position_deviation": 0.0005, "heading_deviation": 0.001, "max_relative": 2.0}
TRUTH = replace(
    ARM,
    base=replace(ARM.base, inertia=0.24, com=(0.004, -0.006)),
    links=(replace(ARM.links[0], b=0.185), *ARM.links[1:3], replace(ARM.links[3], inertia=0.03)),
)


class Bed(Node):
    """Publishes samples, and hears what the calibration says."""

    def __init__(self):
        super().__init__("bed")
        self.outputs = {
            topic: self.create_publisher(kind, topic, sensor(keep_all=True))
            for topic, kind in TYPES.items()
        }
        self.maneuvers, self.results = [], []
        self.create_subscription(Maneuvers, "calibration/maneuvers", self.maneuvers.append, LATCHED)
        self.create_subscription(
            DynamicCalibration, "calibration/dynamic", self.results.append, LATCHED
        )
        self.solver = self.create_client(Trigger, "dynamic/solve")

    def ready(self):
        return self.solver.service_is_ready() and all(
            p.get_subscription_count() for p in self.outputs.values()
        )

    def found(self):
        return len(self.maneuvers[-1].maneuvers) if self.maneuvers else 0


def make_node(**settings):
    return DynamicNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])


@pytest.fixture
def play(spin):
    """play(bed, node, samples): publish them as fast as the node hears them, and solve."""

    def run(bed, node, samples):
        spin([bed, node], bed.ready)
        for k, sample in enumerate(samples, 1):
            topic, content = message(sample)
            bed.outputs[topic].publish(content)
            if k % 100 == 0:
                spin([bed, node], lambda: True)
        finder, newest = node.finder, {s.stream: s.t for s in samples}
        streams = dict(enumerate(finder.joints, 1)) | {"base": finder.base, "gyro": finder.gyro}
        spin(
            [bed, node],
            lambda: all(streams[name].newest >= t for name, t in newest.items()),
            60.0,
        )
        answer = bed.solver.call_async(Trigger.Request())
        return spin([bed, node], lambda: answer.done() and answer.result(), 30.0)

    return run


@pytest.fixture(scope="module")
def samples():
    """Ten maneuvers, the base at 20 Hz."""
    return Float(postures(10, seed=3), TRUTH.vector(), STATE).samples(rate=20)


def test_live_solution_is_the_truth_and_can_be_recomputed(spin, play, samples, tmp_path):
    bed = Bed()
    save(ARM, tmp_path / "guess.yaml")
    files = {"arm": str(tmp_path / "guess.yaml"), "output": str(tmp_path / "found.yaml")}
    node = make_node(**files, **PRECISE)
    answer = play(bed, node, samples)
    assert answer.success, answer.message
    result = spin([bed, node], lambda: bed.found() == 10 and bed.results and bed.results[-1])
    assert result.verdict == "pass"
    assert result.header.frame_id == bed.maneuvers[-1].header.frame_id == "fss"
    found = dict(zip(result.names, result.values, strict=True))
    for name, truth in {
        "b_1": 0.185,
        "b_2": 0.191,
        "I_4": 0.03,
        "I_0": 0.24,
        "y_com": -0.006,
    }.items():
        deviation = result.deviations[list(result.names).index(name)]
        assert abs(found[name] - truth) < 0.3 * deviation, name  # there is no noise
    assert load(tmp_path / "found.yaml").links[0].b == found["b_1"]

    # the maneuvers published give the result again
    settings = settings_of(result.provenance, DynamicSettings)
    again = calibrate(maneuvers_of(bed.maneuvers[-1]), from_yaml(result.guess), settings)
    assert np.abs(again.values - result.values).max() < 1e-9
    assert np.abs(again.covariance.ravel() - result.covariance).max() < 1e-9

    # and so does a bag of the same topics
    bag = record(tmp_path / "bags", samples)
    offline, _ = solve_dynamic_bag(bag, DynamicCalibrationSettings(arm=files["arm"], **PRECISE))
    assert offline.provenance.data_hash == result.provenance.data_hash
    assert np.abs(offline.values - result.values).max() < 1e-9


def test_a_failure_is_published_and_never_written_over_a_good_description(
    spin, play, samples, tmp_path
):
    bed, good = Bed(), tmp_path / "found.yaml"
    save(ARM, good)
    node = make_node(output=str(good), **(PRECISE | {"max_place": 1e-6}))
    answer = play(bed, node, [s for s in samples if s.t < at(100.0)])
    assert not answer.success
    assert answer.message.startswith("fail: too uncertain: ")
    result = spin([bed, node], lambda: bed.results and bed.results[-1])
    assert result.verdict == "fail"
    assert result.description == ""
    assert load(good) == ARM


def test_older_maneuvers_go(ros, samples, tmp_path):
    bag = record(tmp_path, samples)
    _, every = solve_dynamic_bag(bag, DynamicCalibrationSettings(**PRECISE))
    some, newest = solve_dynamic_bag(bag, DynamicCalibrationSettings(kept=7, **PRECISE))
    node = make_node(kept=7, **PRECISE)
    node.take(every[:4])
    node.take(every[4:])
    assert node.maneuvers == newest == every[-7:]
    assert node.calibration.provenance.data_hash == some.provenance.data_hash
    node.take([replace(every[0], used=False, reason="a gap")] * 9)
    assert node.maneuvers[:7] == newest
    assert len(node.maneuvers) == 14
    node.destroy_node()


def telemetry(seconds, armed):
    message = LinkTelemetry(link=2, boot=3, homings=1, armed=armed)
    message.header.stamp = to_time(at(seconds))
    return message


def test_what_is_moved_by_hand_is_kept_unused_live_and_from_bags(spin, play, samples, tmp_path):
    """Link 2 is armed after the first maneuver."""
    some = [s for s in samples if s.t < at(34.0)]
    heard = [telemetry(0.0, False), telemetry(12.0, True)]
    bed, node = Bed(), make_node()
    link = bed.create_publisher(LinkTelemetry, "link_2/telemetry", 10)
    spin([bed, node], link.get_subscription_count)
    for one in heard:
        link.publish(one)
    spin([bed, node], lambda: node.finder.links[1].newest >= at(12.0))
    play(bed, node, some)
    assert [m.reason for m in node.maneuvers] == ["joint_2 moved while disarmed", ""]

    told = Recording(tmp_path / "told")
    told.add("/link_2/telemetry", "fss_arm_msgs/msg/LinkTelemetry", [SENSOR])
    for one in heard:
        told.write("/link_2/telemetry", at(0.0), serialize_message(one))
    told.close()
    _, found = solve_dynamic_bag([told.path, record(tmp_path / "bag", some)])
    assert found == node.maneuvers


def test_forgotten_maneuvers_count_no_more(spin, play, samples):
    """Nor does a clock that ran back."""
    bed, node = Bed(), make_node()
    forget = bed.create_client(Trigger, "dynamic/forget")
    play(bed, node, [s for s in samples if s.t < at(20.0)])
    node.finder.joint(1, at(1.0), 0.0, 0.0)
    assert node.finder.streams().set_back["joint_1"] > 10.0
    spin([bed, node], lambda: bed.found() == 1)
    answer = forget.call_async(Trigger.Request())
    spin([bed, node], lambda: answer.done() and bed.found() == 0)
    assert answer.result().success
    assert answer.result().message == "1 maneuver forgotten"
    spin([bed, node], lambda: bed.results[-1].reason.startswith("0 maneuvers (at least 6)"))
    again = play(bed, node, [s for s in samples if s.t < at(20.0)])
    assert again.message.startswith("not_evaluated: 1 maneuver (at least 6)")
    assert node.finder.streams().set_back["joint_1"] == 0.0


def test_too_little_is_not_evaluated(spin, play, samples):
    bed, node = Bed(), make_node()
    answer = play(bed, node, [s for s in samples if s.t < at(20.0)])
    assert answer.message.startswith("not_evaluated: 1 maneuver (at least 6)")
    assert np.isnan(bed.results[-1].values).all()


@pytest.mark.slow
def test_the_command_for_bags(samples, tmp_path, capsys):
    bag = str(record(tmp_path / "bags", samples))
    output, truth, page = (tmp_path / name for name in ("found.yaml", "truth.yaml", "report"))
    save(TRUTH, truth)
    given = [f"--{k.replace('_', '-')}={v}" for k, v in PRECISE.items()]
    asked = ["--output", str(output), "--truth", str(truth), "--report", str(page)]
    assert from_bag(["--dynamic", bag, *asked, *given]) == 0
    text = capsys.readouterr().out
    for words in ("b_1", "I_0", "0.1850", "S_1", "prior", "pass: 10 maneuvers"):
        assert words in text
    assert load(output).links[0].b == pytest.approx(0.185, abs=2e-3)
    html = (page / "index.html").read_text()
    for words in ("Bias by what was assumed", "What these maneuvers see", "hardly seen"):
        assert words in html
    assert (page / "dynamic_motion.png").read_bytes().startswith(b"\x89PNG")

    assert from_bag(["--dynamic", bag, *given, "--max-place", "1e-6"]) == 2
    assert from_bag(["--dynamic", bag, *given, "--min-maneuvers", "11"]) == 3


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["BAG", "--base-topic", "vicon/x/x"], "no /vicon/x/x in "),
        (["BAG", "--gyro-topic", "joint_states"], "expected sensor_msgs/msg/Imu"),
        (["BAG", "--estimate", "b_i c"], "estimate has 'c'"),
        (["BAG", "--residuals", "tip"], "residuals is 'tip', expected 'pose' or 'heading'"),
        (["/nowhere"], "/nowhere: no such file or folder"),
    ],
)
def test_an_error_of_the_user_is_one_line(samples, tmp_path, capsys, args, message):
    bag = str(record(tmp_path, [s for s in samples if s.t < at(4.0)]))
    assert from_bag(["--dynamic", *(bag if a == "BAG" else a for a in args)]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("from_bag: ")
    assert error.count("\n") == 1


def test_node_and_command_have_the_same_settings(ros):
    node = make_node()
    options = parser(DynamicCalibrationSettings).parse_args(["bag", "--dynamic"])
    for f in fields(DynamicCalibrationSettings):
        assert getattr(options, f.name) == node.get_parameter(f.name).value == f.default
    node.destroy_node()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"arm": "/nowhere/arm.yaml"}, "/nowhere/arm.yaml"),
        ({"estimate": "b_9x"}, "estimate has 'b_9x'"),
        ({"longest": 0.1}, "longest is 0.1 s, must be at least 0.5 s"),
    ],
)
def test_impossible_parameters_are_refused(ros, settings, message):
    with pytest.raises((ValueError, OSError), match=message):
        make_node(**settings)


def test_a_report_is_written_when_asked_to_solve(ros, tmp_path):
    node = make_node(report=str(tmp_path / "report"))
    answer = node.on_solve(Trigger.Request(), Trigger.Response())
    assert not answer.success
    assert "needed" in answer.message or "at least" in answer.message
    assert "not evaluated" in (tmp_path / "report" / "index.html").read_text()
    node.destroy_node()
