"""What is the node `dynamic`'s own: the truth, what is moved by hand, its report."""

import pytest
from calib_float import Float, at, message, postures, record
from calib_kinds import STATE, TRUTH, Bed, ask, make_node, play
from rclpy.serialization import serialize_message

from fss_arm_bags.recorder import Recording
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.from_bag import solve_bag
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import to_time
from fss_arm_ros.qos import SENSOR


@pytest.fixture(scope="module")
def samples():
    """Ten maneuvers, the base at 20 Hz."""
    return Float(postures(10, seed=3), TRUTH.vector(), STATE).samples(rate=20)


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
    spin([bed, node], lambda: node.finder.sensors.links[1].newest >= at(12.0))
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
