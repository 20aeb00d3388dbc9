"""The node view: drawings of a flight, and reaction to a stopped viewer."""

import json
import socket
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
import rerun_cli
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped, Transform
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import free_port, wait_until
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from view_bench import BEGIN, Bench
from view_flight import Flight
from view_scene import Scene
from visualization_msgs.msg import Marker, MarkerArray

from fss_arm_model.description import paper_arm
from fss_arm_msgs.msg import (
    BaseReaction,
    Calibration,
    DynamicCalibration,
    KinematicCalibration,
    LinkTelemetry,
    MissionState,
    ThrusterCommand,
)
from fss_arm_ros.convert import SECOND, pose_stamped, to_time
from fss_arm_ros.diagnostics import ERROR, OK, WARN
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_arm_view.sink import Viewer, host, listen
from fss_arm_view.strip import HEADING
from fss_arm_view.view_node import ViewNode
from fss_arm_workspace.workspace_node import WorkspaceNode


def view(**settings):
    return ViewNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])


def recorded_text(node, file):
    """Close a view; return the text of its recording."""
    node.close()
    node.sink.stream.disconnect()
    rerun = Path(rerun_cli.__file__).parent / "rerun"
    return subprocess.run(
        [rerun, "rrd", "print", "-vvv", file],
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
        check=True,
    ).stdout


def test_several_vehicles_are_shown_in_one_recording(spin, tmp_path):
    file = tmp_path / "view.rrd"
    node = view(mode="file", file=str(file))
    added = [node.add_vehicle(name) for name in ("fss1", "fss2")]
    nodes, vehicles = [node, *added], node.vehicles
    source, topics = Node("source"), []
    for name in ("fss1", "fss2"):
        topics.append(source.create_publisher(PoseStamped, f"/vicon/{name}/{name}", SENSOR))
        topics.append(source.create_publisher(JointState, f"/{name}/joint_states", SENSOR))
    stop = source.create_publisher(Empty, "/fss2/arm/stop", 10)
    logged, log_event = [], vehicles[1].log_event
    vehicles[1].log_event = lambda *event: (logged.append(event), log_event(*event))
    spin([*nodes, source], lambda: all(t.get_subscription_count() for t in [*topics, stop]))
    for k, topic in enumerate(topics):
        message = pose_stamped(BEGIN, "world", (float(k), 0.0, 0.0))
        if k % 2:
            message = JointState(name=["joint_2"], position=[0.1], velocity=[0.0], effort=[0.0])
            message.header.stamp = to_time(BEGIN)
        topic.publish(message)
    stop.publish(Empty())
    spin(nodes, lambda: all(one.scene.q[1] == 0.1 for one in vehicles))
    spin(nodes, lambda: all({"base", "joints"} <= one.stamps.keys() for one in vehicles))
    spin(nodes, lambda: logged)
    shown = recorded_text(node, file)
    for name in ("fss1", "fss2"):
        assert f"/table/{name}/arm" in shown
        assert f"/table/{name}/name" in shown
        assert f"/plot/angle/{name}/link_2" in shown
    assert "fss2: arm/stop" in shown
    assert "/table/arm" not in shown


def test_the_error_of_a_node_is_shown_in_the_strips_of_its_vehicles(ros, tmp_path):
    node = view(mode="file", file=str(tmp_path / "view.rrd"))
    added = [node.add_vehicle(name) for name in ("fss1", "fss2")]
    errors = ("/mocap", "no frames"), ("/fss2/link_1", "lost")
    statuses = [DiagnosticStatus(name=name, message=m, level=ERROR) for name, m in errors]
    node.on_diagnostics(DiagnosticArray(status=statuses))
    first, second = (vehicle.strip.items(time.monotonic()) for vehicle in node.vehicles)
    assert [item.value for item in first[-1:]] == ["no frames"]
    assert [item.value for item in second[-2:]] == ["no frames", "lost"]
    node.close()
    for one in (node, *added):
        one.destroy_node()


def test_the_heading_s_band_is_that_of_prediction_and_measurement(ros, tmp_path):
    node, one = view(mode="file", file=str(tmp_path / "view.rrd")), [0.0, 0.0, 1.0]
    heading = {"difference": [0.0, 0.0, 4.0], "predicted_deviation": one}
    node.own.on_reaction(BaseReaction(measured_deviation=one, **heading))
    (difference, sigma), _ = node.own.strip.values[HEADING]
    assert (difference, sigma) == (4.0, pytest.approx(2.0**0.5))
    node.close()
    node.destroy_node()


@pytest.fixture(scope="module")
def flight():
    return Flight(paper_arm(), end=1.0)


def test_published_messages_are_shown(spin, flight, tmp_path):
    file = tmp_path / "view.rrd"
    node, bench = view(mode="file", file=str(file)), Bench(flight)
    reactions = bench.create_publisher(BaseReaction, "base_reaction", SENSOR)
    telemetry = bench.create_publisher(LinkTelemetry, "link_2/telemetry", SENSOR)
    stops = bench.create_publisher(Empty, "arm/stop", 10)
    dynamic = bench.create_publisher(DynamicCalibration, "calibration/dynamic", LATCHED)
    thrust = bench.create_publisher(ThrusterCommand, "thrusters/pulses", SENSOR)
    mission = bench.create_publisher(MissionState, "mission/state", SENSOR)
    base_path = bench.create_publisher(MultiDOFJointTrajectory, "base/trajectory", SENSOR)
    target = bench.create_publisher(PoseStamped, "vicon/target/target", SENSOR)
    used = (bench.joints, bench.pose, bench.calibration, reactions, telemetry, stops, dynamic)
    used += (thrust, target, mission, base_path)
    spin([node, bench], lambda: all(p.get_subscription_count() for p in used))
    reactions.publish(BaseReaction())
    for sequence in (1, 2, 5):  # two are missing
        telemetry.publish(LinkTelemetry(link=2, sequence=sequence, current=120))
    stops.publish(Empty())
    thrust.publish(ThrusterCommand(on_time=[0.0, 9.0, *[0.0] * 6]))
    path = [0.5, 0.0, 0.0, 1.0, 0.5, 1.0]
    mission.publish(MissionState(mission="capture", phase="reach", path=path, keep_out=0.6))
    point = MultiDOFJointTrajectoryPoint(transforms=[Transform()])
    base_path.publish(MultiDOFJointTrajectory(points=[point]))
    target.publish(pose_stamped(1, "world", (1.0, 1.0, 0.0)))
    dynamic.publish(
        DynamicCalibration(calibration=Calibration(verdict="fail", reason="no maneuvers"))
    )
    bench.calibration.publish(
        KinematicCalibration(calibration=Calibration(verdict="fail", reason="too few"))
    )
    bench.play(400)
    spin([node, bench], lambda: node.own.losses[2].share)
    names, now = {"thrusters", "target", "path planned"}, node.own.scene.mission
    spin([node, bench], lambda: names <= set(node.legend.names))
    spin([node, bench], lambda: now.path(node.own.t) == [(0.5, 0.0), (1.0, 0.5)])
    assert now.keep_out(node.own.t) == 0.6
    end = BEGIN + 390_000_000
    spin([node, bench], lambda: node.own.t >= end and node.sink.counts["shown"] >= 12)
    assert node.health().level == OK
    shown = recorded_text(node, file)
    for words in (
        "/table/edge",
        "/table/arm",
        "/table/center_of_mass",
        "/table/target",
        "/plot/angle/link_1",
        "/plot/loss/link_2",
        "/plot/heading/predicted",
        "arm/stop",
        "capture: reach",
        "too few",
        "no maneuvers",
    ):
        assert words in shown


def test_a_mission_s_end_has_its_reason_and_frees_the_drawing_for_the_base_s_path(ros, tmp_path):
    node = view(mode="file", file=str(tmp_path / "view.rrd"))
    topics, mission = node.own, node.own.scene.mission
    topics.on_base(pose_stamped(BEGIN, "world", (0.0, 0.0, 0.0)))
    topics.on_mission(MissionState(mission="capture", phase="abort", reason="base lost"))
    assert mission.text == "capture: abort, base lost"
    topics.on_base(pose_stamped(BEGIN + 3 * SECOND, "world", (0.3, 0.0, 0.0)))
    assert mission.text == ""
    point = MultiDOFJointTrajectoryPoint(transforms=[Transform()])
    topics.on_trajectory(MultiDOFJointTrajectory(points=[point] * 3))
    assert mission.path(topics.t) == [(0.0, 0.0)] * 3
    node.close()
    node.destroy_node()


@pytest.mark.parametrize("measured", ["joints", "base"])
def test_events_are_drawn_at_the_time_of_the_last_measurement(ros, tmp_path, measured):
    """Its stamp may be of today during the replay of an older bag."""
    node, drawn = view(mode="file", file=str(tmp_path / "view.rrd")), []
    node.sink.enqueue = lambda t, drawings: drawn.append((t, drawings[0][0]))
    if measured == "joints":
        stamp = to_time(5 * SECOND)
        node.own.on_joints(JointState(header=Header(stamp=stamp), name=["joint_1"], position=[0.1]))
    else:
        node.own.on_base(pose_stamped(5 * SECOND, "world", (0.0, 0.0, 0.0)))
    today = Header(stamp=to_time(1_800_000_000 * SECOND), frame_id="fss")
    node.on_diagnostics(DiagnosticArray(header=today, status=[DiagnosticStatus(name="replay")]))
    node.own.on_stop(Empty())
    node.own.on_calibration(
        "calibration/kinematic", KinematicCalibration(calibration=Calibration(header=today))
    )
    line = Marker(header=today, type=Marker.LINE_STRIP, points=[Point(), Point(x=1.0)])
    node.own.on_outlines("workspace/markers", MarkerArray(markers=[line]))
    assert [what for _, what in drawn].count("log") == 3
    assert {t for t, what in drawn if "legend" not in what} == {5 * SECOND}
    node.close()
    node.destroy_node()


def test_a_backward_jump_of_stamps_starts_a_new_recording(ros, tmp_path):
    """Otherwise the viewer would stay at the newest drawing; latched outlines are drawn again."""
    node = view(mode="file", file=str(tmp_path / "view.rrd"), rate=1e9)
    topics, drawn = node.own, node.own.scene
    line = Marker(ns="reach", type=Marker.LINE_STRIP, points=[Point(), Point(x=1.0)])
    topics.on_outlines("workspace/markers", MarkerArray(markers=[line]))
    topics.on_stop(Empty())
    for begin in (100, 0):
        for k in range(30):
            t = begin * SECOND + k * SECOND // 100
            topics.on_base(pose_stamped(t, "world", (0.0, 0.0, 0.0)))
            topics.on_tip(pose_stamped(t, "world", (begin + 0.1 * k, 0.0, 0.0)))
        if begin:
            topics.on_reaction(BaseReaction(header=Header(stamp=to_time(t))))
            topics.on_thrust(ThrusterCommand(on_time=[9.0] * 8))
    assert drawn.trails["tip_path"]
    assert max(x for x, _ in drawn.trails["tip_path"]) < 10.0
    assert not drawn.trails["com_path"]
    assert drawn.difference is None
    assert not any(drawn.plumes_until)
    first, second = (recorded_text(node, tmp_path / name) for name in ("view.rrd", "view_1.rrd"))
    assert "arm/stop" in first
    assert "arm/stop" not in second
    for entity in ("/table/edge", "/table/outlines/reach", "/table/legend/5", "/table/arm"):
        assert entity in first
        assert entity in second
    node.destroy_node()


def test_the_workspace_is_drawn_in_its_frame(spin, flight, tmp_path):
    file = tmp_path / "view.rrd"
    node, bench = view(mode="file", file=str(file)), Bench(flight)
    parameters = {"cell": 0.2, "directions": 12}
    workspace = WorkspaceNode(
        parameter_overrides=[Parameter(k, value=v) for k, v in parameters.items()]
    )
    nodes = [node, bench, workspace]
    spin(nodes, lambda: bench.joints.get_subscription_count() == 2)
    bench.play(400)
    boundaries = {"fixed vehicle workspace", "maximum reachable workspace"}
    boundaries |= {f"straight paths, {base}" for base in ("fixed", "floating", "zero reaction")}
    spin(nodes, lambda: boundaries <= set(node.legend.names), 60.0)
    shown = recorded_text(node, file)
    assert "/table/fss/fixed_vehicle_workspace" in shown
    assert "straight paths, zero reaction" in shown  # in the legend
    in_base, in_world = (f"/table/{of}/straight_paths_floating" for of in ("fss", "outlines"))
    assert in_base in shown
    assert in_world in shown


@pytest.mark.parametrize("part", [0, 1], ids=["rerun", "gate"])
def test_a_stopped_viewer_is_an_error(spin, part):
    node = view(mode="web", port=free_port(), web_port=free_port())
    spin(node, lambda: node.viewer.is_running())
    node.viewer.processes[part].kill()
    spin(node, lambda: node.health().level == ERROR)
    assert node.health().message == "the viewer has stopped; restart this node"


OWNER = """
import sys
from fss_arm_view.sink import Viewer, listen
ports = listen("web", "127.0.0.1", int(sys.argv[1]), int(sys.argv[2]))
viewer = Viewer("web", "127.0.0.1", ports, "100MB")
print(*(process.pid for process in viewer.processes), flush=True)
viewer.processes[0].wait()
"""


def test_a_viewer_stops_with_its_owner():
    command = [sys.executable, "-c", OWNER, str(free_port()), str(free_port())]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as owner:
        rerun, gate = (Path(f"/proc/{pid}/cmdline") for pid in owner.stdout.readline().split())
        wait_until(lambda: "rerun" in rerun.read_text(), 10.0, lambda: time.sleep(0.05))
        wait_until(lambda: "gate" in gate.read_text(), 10.0, lambda: time.sleep(0.05))
        owner.kill()
    wait_until(lambda: not rerun.exists() and not gate.exists(), 10.0, lambda: time.sleep(0.05))


@pytest.mark.parametrize(
    ("taken", "mode"), [("port", "web"), ("web_port", "web"), ("port", "native")]
)
def test_a_port_in_use_is_named_with_its_option(ros, taken, mode):
    ports = {"port": free_port(), "web_port": free_port()}
    with socket.create_server(("127.0.0.1", ports[taken])):
        words = rf"cannot open port {ports[taken]} of 127.0.0.1: .* -p {taken}:=PORT"
        with pytest.raises(ValueError, match=words):
            view(mode=mode, **ports)


def test_the_page_receives_the_state(spin):
    """The browser's page reads the same events."""
    web_port = free_port()
    node, scene = view(mode="web", port=free_port(), web_port=web_port), Scene()
    spin([node, scene], lambda: node.own.scene.pose and node.own.scene.target, 60.0)
    node.update()
    with urlopen(f"http://127.0.0.1:{web_port}/events") as events:
        lines = (json.loads(line[6:]) for line in events if line.startswith(b"data: "))
        state = next(state for state in lines if state["stamp"])
    assert abs(time.time() - state["stamp"]) < 60.0
    assert state["vehicles"][0]["pose"]


def test_an_open_address_is_logged_with_a_warning(spin, capfd):
    port, web_port, logged = free_port(), free_port(), []
    node = view(mode="web", bind="0.0.0.0", port=port, web_port=web_port)
    name = socket.gethostname()

    def is_warned():
        logged.append(capfd.readouterr().err)
        return f"{name}:{port} has no authentication" in "".join(logged)

    spin(node, is_warned)
    assert f"open http://{name}:{web_port}" in "".join(logged)


def test_only_the_gate_listens_at_the_bound_address(spin):
    ports = free_port(), free_port()
    node = view(mode="web", bind="127.0.0.2", port=ports[0], web_port=ports[1])
    table = Path("/proc/net/tcp")  # addresses and states of sockets
    listening = [f"0200007F:{port:04X} 00000000:0000 0A" for port in ports]
    spin(node, lambda: all(line in table.read_text() for line in listening))
    inner = int(node.viewer.url.split(":")[2].split("/")[0])
    spin(node, lambda: f"0100007F:{inner:04X} 00000000:0000 0A" in table.read_text())
    spin(node, lambda: f"0100007F:{inner:04X} 01" in table.read_text())  # the node is connected


@pytest.mark.parametrize(
    ("bind", "name"), [("0.0.0.0", "lab"), ("127.0.0.2", "127.0.0.2"), ("127.0.0.1", "localhost")]
)
def test_the_page_may_read_the_data_under_any_allowed_name(bind, name):
    """A browser sends this request before a page reads from another port."""
    port, web_port = free_port(), free_port()
    viewer = Viewer("web", bind, listen("web", bind, port, web_port), "100MB")
    origin = f"http://{name}:{web_port}"
    request_headers = {"Origin": origin, "Access-Control-Request-Method": "POST"}
    url = f"http://{host(bind, '127.0.0.1')}:{port}/"

    def answer():
        with (
            suppress(OSError),
            urlopen(Request(url, method="OPTIONS", headers=request_headers)) as found,
        ):
            return found.headers

    try:
        headers = wait_until(answer, 10.0, lambda: time.sleep(0.05))
    finally:
        viewer.close()
    assert headers["Access-Control-Allow-Origin"] == origin


@pytest.mark.parametrize(
    ("bind", "name"),
    [("192.168.1.7", "192.168.1.7"), ("::1", "[::1]"), ("::", "x"), ("0.0.0.0", "x")],
)
def test_an_address_in_a_url(bind, name):
    assert host(bind, "x") == name


def test_a_viewer_that_accepts_nothing_is_reported(ros, tmp_path):
    node = view(mode="file", file=str(tmp_path / "view.rrd"))
    node.sink.counts = Counter(shown=3)
    assert node.health().level == OK
    node.sink.counts = Counter(shown=3, dropped=1)
    assert node.health().level == WARN
    node.sink.counts = Counter(shown=4, dropped=2)
    assert node.health().level == OK
    node.close()
    node.destroy_node()
