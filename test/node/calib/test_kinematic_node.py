"""What is the node `kinematic`'s own: rests seen live, homings, gaps, replay."""

import numpy as np
import pytest
from calib_kinds import Bed, ask, make_node, play
from calib_rig import TOPICS, Rig, Sample, at, message, record, resting
from rclpy.parameter import Parameter

from fss_arm_bags.reader import BagError
from fss_arm_bags.replay_node import ReplayNode
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_msgs.msg import LinkTelemetry


@pytest.fixture(scope="module")
def samples():
    return resting(lag=3_000_000)


@pytest.fixture(scope="module")
def bag(samples, tmp_path_factory):
    return record(tmp_path_factory.mktemp("bag"), samples)


def homed(seconds, homings):
    """What link 2 tells."""
    return Sample(at(seconds), "link_2", (False, 3, homings))


def test_a_link_homed_later_asks_for_its_offsets(spin, samples):
    bed, node = Bed(KINEMATIC), make_node(KINEMATIC)
    link = bed.create_publisher(LinkTelemetry, "link_2/telemetry", 10)
    spin([bed, node], link.get_subscription_count)
    link.publish(message(homed(0.0, 1))[1])
    play(spin, bed, node, [s for s in samples if s.t < at(9.0)])
    ask(spin, bed, node, bed.solver)
    result = spin([bed, node], lambda: bed.found() == 2 and bed.results[-1])
    assert list(result.boots) == [0, 3, 0, 0]
    assert list(result.homings) == [0, 1, 0, 0]
    assert node.health().message == "2 observations"
    link.publish(message(homed(100.0, 2))[1])
    said = "joint_2 homed or restarted since: observe new rests"
    spin([bed, node], lambda: node.health().message == said)
    assert ask(spin, bed, node, bed.solver).message.endswith(f"; but {said}")


def test_homings_are_read_from_bags(bag, tmp_path):
    told = record(tmp_path / "a", [homed(0.0, 1), homed(14.0, 2)])
    found = solve_bag(KINEMATIC, [told, bag])
    assert found.used[-1].homings == (0, 2, 0, 0)
    assert len(found.used) == 5
    assert "3 observations left out: joint_2 homed or restarted since" in found.reason
    assert found.summary.count("3 observations left out: joint_2 homed or restarted since") == 1


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["/nowhere"], "/nowhere: no such file or folder"),
        (["BAG", "--arm", "/nowhere.yaml"], "/nowhere.yaml"),
        (["BAG", "--tip-topic", "nothing"], ", which has /vicon/"),
        (["BAG", "--dynamic", "--base-topic", "vicon/x/x"], "no /vicon/x/x in "),
        (["BAG", "--tip-topic", "joint_states"], "expected geometry_msgs/msg/PoseStamped"),
        (["BAG", "--report", "/dev/null/report"], "/dev/null/report"),
        (["BAG", "--settle-time", "x"], "argument --settle-time: invalid float value: 'x'"),
        (["BAG", "--dynamic", "--drift"], "argument --drift: not allowed with argument --dynamic"),
        (["--drives", "BAG"], "no /link_1/telemetry in "),
    ],
)
def test_an_error_of_the_user_is_one_line(bag, capsys, args, message):
    try:
        code = from_bag([str(bag) if a == "BAG" else a for a in args])
    except SystemExit as end:
        code = end.code
    assert code == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("from_bag: ")
    assert error.count("\n") == 1


VEHICLE_2 = {
    "joint_states": "fss2/joint_states",
    "vicon/fss/fss": "vicon/fss2/fss2",
    "vicon/end_effector/end_effector": "vicon/fss2_end_effector/fss2_end_effector",
}


def test_of_bags_of_two_vehicles_each_is_calibrated_from_its_own(bag, tmp_path, capsys):
    others = Rig(DEFAULT_POSTURES[:8] * 0.9, seed=3, rest=3.2, rate=25.0).samples(lag=3_000_000)
    both = [bag, record(tmp_path / "second", others, renamed=VEHICLE_2.get)]
    for alone, space in ((bag, ""), (record(tmp_path / "other", others), "fss2")):
        found = [solve_bag(KINEMATIC, *given) for given in ((alone,), (both, None, space))]
        assert found[0].provenance.data_hash == found[1].provenance.data_hash
    assert from_bag([*map(str, both), "--namespace", "fss3"]) == 1
    assert "no /fss3/joint_states" in capsys.readouterr().err


def test_bags_are_taken_one_after_the_other(samples, bag, tmp_path):
    whole = solve_bag(KINEMATIC, bag)
    record(tmp_path / "parts", [s for s in samples if s.t < at(20.0)])
    record(tmp_path / "parts", [s for s in samples if s.t >= at(20.0)])
    parts = solve_bag(KINEMATIC, tmp_path / "parts")
    assert parts.provenance.data_hash == whole.provenance.data_hash
    with pytest.raises(BagError):
        solve_bag(KINEMATIC, tmp_path)


def test_replayed_the_result_is_that_of_the_bag(spin, samples, bag):
    offline = solve_bag(KINEMATIC, bag)
    node = make_node(KINEMATIC)
    settings = {"rate": 0.0, "discovery": 0.0, "wait_for": ["joint_states", *TOPICS.values()]}
    player = ReplayNode(
        str(bag), parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    with pytest.raises(SystemExit) as end:
        spin([player, node], lambda: False, 60.0)
    assert end.value.code == 0
    newest = {s.stream: s.t for s in samples}
    sensors = node.finder.sensors
    spin(node, lambda: all(p.newest == newest[s] for s, p in sensors.subjects.items()))
    spin(node, lambda: all(j.newest == newest[i] for i, j in enumerate(sensors.joints, 1)))
    node.add_data(node.finder.close())
    replayed = node.outcome
    assert replayed.provenance.data_hash == offline.provenance.data_hash
    assert np.abs(replayed.values - offline.values).max() < 1e-9
    assert np.abs(replayed.covariance - offline.covariance).max() < 1e-9
    assert replayed.streams.offset.value == pytest.approx(offline.streams.offset.value, abs=1e-9)
