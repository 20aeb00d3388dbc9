"""What is the node `dynamic`'s own: the truth, what is moved by hand, its report."""

import pytest
from calib_float import Float, at, message, postures, record
from calib_kinds import PRECISE, STATE, TRUTH, Bed, ask, make_node, play
from rclpy.serialization import serialize_message

from fss_arm_bags.recorder import Recording
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_model.description_file import load, save
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import to_time
from fss_arm_ros.qos import SENSOR


@pytest.fixture(scope="module")
def samples():
    """Ten maneuvers, the base at 20 Hz."""
    return Float(postures(10, seed=3), TRUTH.vector(), STATE).samples(rate=20)


def test_the_truth_comes_back(samples, tmp_path):
    """There is no noise."""
    found = solve_bag(DYNAMIC, record(tmp_path, samples), DYNAMIC.settings(**PRECISE))
    assert found.verdict == "pass"
    values = dict(zip(found.names, zip(found.values, found.deviations, strict=True), strict=True))
    for name, truth in {
        "b_1": 0.185, "b_2": 0.191, "I_4": 0.03, "I_0": 0.24, "y_com": -0.006,
    }.items():  # fmt: skip
        value, deviation = values[name]
        assert abs(value - truth) < 0.3 * deviation, name


def telemetry(seconds, armed):
    message = LinkTelemetry(link=2, boot=3, homings=1, armed=armed)
    message.header.stamp = to_time(at(seconds))
    return message


def test_what_is_moved_by_hand_is_kept_unused_live_and_from_bags(spin, samples, tmp_path):
    """Link 2 is armed after the first maneuver."""
    some = [s for s in samples if s.t < at(34.0)]
    heard = [telemetry(0.0, False), telemetry(12.0, True)]
    bed, node = Bed(DYNAMIC), make_node(DYNAMIC)
    link = bed.create_publisher(LinkTelemetry, "link_2/telemetry", 10)
    spin([bed, node], link.get_subscription_count)
    for one in heard:
        link.publish(one)
    spin([bed, node], lambda: node.finder.links[1].newest >= at(12.0))
    play(spin, bed, node, some, message)
    ask(spin, bed, node, bed.solver)
    assert [m.reason for m in node.data] == ["joint_2 moved while disarmed", ""]

    told = Recording(tmp_path / "told")
    told.add("/link_2/telemetry", "fss_arm_msgs/msg/LinkTelemetry", [SENSOR])
    for one in heard:
        told.write("/link_2/telemetry", at(0.0), serialize_message(one))
    told.close()
    found = solve_bag(DYNAMIC, [told.path, record(tmp_path / "bag", some)])
    assert list(found.data) == node.data


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
    for words in (
        "Bias due to assumed parameters",
        "Visibility of combinations of parameters",
        "hardly seen",
    ):
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
        (["BAG", "--residuals", "tip"], "residuals is 'tip', expected one of pose, heading"),
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
