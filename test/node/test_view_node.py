"""The node view: what it shows of a flight, and that it notices its viewer's end."""

import socket
import subprocess
from pathlib import Path

import pytest
import rerun_cli
from geometry_msgs.msg import Point32, Polygon, PolygonStamped
from rclpy.parameter import Parameter
from std_msgs.msg import Empty
from view_bench import Bench
from view_flight import Flight

from fss_arm_model.description import paper_arm
from fss_arm_msgs.msg import BaseReaction, KinematicCalibration, LinkTelemetry
from fss_arm_ros.diagnostics import ERROR, OK
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_arm_view.view_node import ViewNode


def view(**settings):
    return ViewNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture(scope="module")
def flight():
    return Flight(paper_arm(), end=1.0)


def test_what_is_published_is_shown(spin, flight, tmp_path):
    file = tmp_path / "view.rrd"
    node, bench = view(mode="file", file=str(file)), Bench(flight)
    reacts = bench.create_publisher(BaseReaction, "base_reaction", SENSOR)
    tells = bench.create_publisher(LinkTelemetry, "link_2/telemetry", SENSOR)
    stops = bench.create_publisher(Empty, "arm/stop", 10)
    bounds = bench.create_publisher(PolygonStamped, "workspace/fixed", LATCHED)
    used = (bench.joints, bench.pose, bench.calibration, reacts, tells, stops, bounds)
    spin([node, bench], lambda: all(p.get_subscription_count() for p in used))
    reacts.publish(BaseReaction())
    for sequence in (1, 2, 5):  # two are missing
        tells.publish(LinkTelemetry(link=2, sequence=sequence, current=120))
    stops.publish(Empty())
    bounds.publish(PolygonStamped(polygon=Polygon(points=[Point32(x=1.0), Point32(y=1.0)])))
    bench.calibration.publish(KinematicCalibration(verdict="fail", reason="too few"))
    bench.play(400)
    spin([node, bench], lambda: node.losses.get(2))
    spin([node, bench], lambda: node.sink.counts["shown"] >= 8)
    assert node.losses[2] == pytest.approx(0.05 * 2 / 3)
    assert node.health().level == OK
    node.close()
    node.sink.stream.disconnect()
    rerun = Path(rerun_cli.__file__).parent / "rerun"
    shown = subprocess.run(
        [rerun, "rrd", "print", "-vvv", file], capture_output=True, text=True, timeout=60,
        check=True,
    ).stdout  # fmt: skip
    for entity in ("/table/base", "/table/arm/links", "/plot/angle/link_1", "/plot/loss/link_2"):
        assert entity in shown
    for entity in ("/table/predicted", "/table/boundary/fixed", "arm/stop", "too few"):
        assert entity in shown


def test_a_viewer_that_ended_is_an_error_and_not_the_end(spin):
    node = view(mode="web", port=free_port(), web_port=free_port())
    spin(node, lambda: node.viewer.alive())
    node.viewer.process.kill()
    spin(node, lambda: node.health().level == ERROR)
    assert node.health().message == "the viewer has ended"


def test_an_open_address_is_warned_of(spin, capfd):
    port = free_port()
    node = view(mode="web", bind="0.0.0.0", port=port, web_port=free_port())
    spin(node, lambda: f"whoever reaches 0.0.0.0:{port}" in capfd.readouterr().err)
