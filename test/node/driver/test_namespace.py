"""Two vehicles of one link each, in namespaces: shared topics distinguish them."""

from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from driver_link import RATE, FakeTransport
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.link_node import LinkNode
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR

VEHICLES = "fss1", "fss2"


@pytest.fixture
def arm(tmp_path):
    whole = paper_arm()
    save(replace(whole, links=whole.links[:1]), tmp_path / "arm.yaml")
    return Parameter("arm", value=str(tmp_path / "arm.yaml"))


def test_frames_and_reports_carry_the_vehicles_namespace(spin, arm):
    link = [Parameter("rate", value=RATE), Parameter("timeout", value=5.0), arm]
    nodes = []
    for vehicle in VEHICLES:
        transport = FakeTransport(1)
        given = {"namespace": vehicle, "parameter_overrides": link}
        nodes.append(LinkNode(1, transport=transport, **given))
        nodes.append(ArmNode(namespace=vehicle, parameter_overrides=[arm]))
    user, frames, reports, telemetry = Node("user"), set(), set(), {}

    def transforms(message):
        frames.update((t.header.frame_id, t.child_frame_id) for t in message.transforms)

    user.create_subscription(TFMessage, "/tf", transforms, SENSOR)
    of_all = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # as tf2 listens
    user.create_subscription(TFMessage, "/tf_static", transforms, of_all)
    user.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: reports.update(s.name for s in m.status), 10
    )
    for vehicle in VEHICLES:
        user.create_subscription(
            LinkTelemetry,
            f"{vehicle}/link_1/telemetry",
            lambda m, vehicle=vehicle: telemetry.update({vehicle: m.header.frame_id}),
            SENSOR,
        )
    chain = [("fss", "fss_body"), ("fss", "link_1"), ("link_1", "end_effector")]
    expected = {(f"{v}/{a}", f"{v}/{b}") for v in VEHICLES for a, b in chain}
    spin([*nodes, user], lambda: len(reports) == 4 and len(telemetry) == 2 and frames >= expected)
    assert frames == expected
    assert reports == {f"/{v}/{name}" for v in VEHICLES for name in ("link_1", "arm")}
    assert telemetry == {v: f"{v}/link_1" for v in VEHICLES}
