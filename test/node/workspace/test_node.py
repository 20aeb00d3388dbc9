"""The node `workspace` on real topics."""

from functools import partial
from threading import Event

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped
from model_arms import short_arm
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import wait_until
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import from_yaml, to_yaml
from fss_arm_model.layout import kinematic_index
from fss_arm_msgs.msg import (
    Calibration,
    KinematicCalibration,
    ManipulabilityMap,
    StraightPaths,
    Workspace,
)
from fss_arm_ros.convert import pose_stamped, stamp_ns
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_arm_workspace.regions.fixed import fixed_workspace
from fss_arm_workspace.straight_path.paths import arch
from fss_arm_workspace.worker import Superseded, Worker
from fss_arm_workspace.workspace_node import WorkspaceNode

TOPICS = {
    "result": Workspace,
    "boundary": PolygonStamped,
    "map/fixed": OccupancyGrid,
    "manipulability/floating": ManipulabilityMap,
    "straight_paths/floating": StraightPaths,
    "straight/zero_reaction": PolygonStamped,
    "markers": MarkerArray,
    "straight_markers": MarkerArray,
    "ellipsoids": MarkerArray,
}


class Viewer(Node):
    """Node that receives the results, and publishes joint readings and poses."""

    def __init__(self):
        super().__init__("viewer")
        self.heard = {topic: [] for topic in TOPICS}
        for topic, kind in TOPICS.items():
            self.create_subscription(kind, f"workspace/{topic}", self.heard[topic].append, LATCHED)
        self.told = []
        self.create_subscription(DiagnosticArray, "/diagnostics", self.told.append, 10)
        self.joints = self.create_publisher(JointState, "joint_states", SENSOR)
        self.base = self.create_publisher(type(pose_stamped(0, "", (0, 0, 0))), "vicon/fss/fss", 10)
        self.calibration = self.create_publisher(
            KinematicCalibration, "calibration/kinematic", LATCHED
        )

    def last(self, topic):
        return self.heard[topic][-1] if self.heard[topic] else None

    def say_posture(self, q):
        names = [f"joint_{i}" for i in range(1, len(q) + 1)]
        self.joints.publish(JointState(name=names, position=[float(x) for x in q]))


def make_node(**settings):
    settings = {"cell": 0.1, "directions": 24, **settings}
    return WorkspaceNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])


def calibrated(arm, **fields):
    one = Calibration(verdict="pass", description=to_yaml(arm), **fields)
    return KinematicCalibration(calibration=one)


@pytest.mark.slow
def test_maps_and_paths_are_published(spin):
    viewer, node = Viewer(), make_node()
    nodes, arm, q = [viewer, node], paper_arm(), arch(paper_arm())[3:]
    spin(nodes, partial(viewer.last, "result"), 60.0)
    result, found = viewer.last("result"), fixed_workspace(arm)
    assert result.area == pytest.approx(found.area)
    assert result.radius == pytest.approx(1.172, abs=5e-4)
    assert from_yaml(result.description) == arm
    assert found.distance(np.array(result.x) + 1j * np.array(result.y)).max() < 1e-9
    spin(nodes, partial(viewer.last, "map/fixed"))
    grid = viewer.last("map/fixed")
    assert (grid.header.frame_id, max(grid.data), min(grid.data)) == ("fss", 100, -1)
    spin(nodes, partial(viewer.last, "manipulability/floating"))
    full = viewer.last("manipulability/floating")
    assert len(full.w) == full.width * full.height == len(grid.data)
    assert not viewer.heard["ellipsoids"]

    spin(nodes, lambda: viewer.joints.get_subscription_count())
    viewer.say_posture(q)
    spin(nodes, partial(viewer.last, "straight_paths/floating"), 60.0)
    paths = viewer.last("straight_paths/floating")
    assert paths.header.frame_id == "fss"
    assert paths.start == pytest.approx([0, 0, 0, *q])
    assert max(paths.distance) > 0.5
    fixed, floating = spin(nodes, partial(viewer.last, "ellipsoids")).markers
    assert fixed.scale.x > floating.scale.x > 0.0

    spin(nodes, lambda: viewer.base.get_subscription_count())
    viewer.base.publish(pose_stamped(0, "world", (0.5, -0.2, 1.0)))
    spin(nodes, lambda: viewer.last("straight_paths/floating").header.frame_id == "world", 60.0)
    assert viewer.last("straight_paths/floating").start[:3] == pytest.approx([0.5, -0.2, 1.0])

    longer = arm.with_kinematics(arm.vector()[kinematic_index(4)] * 1.05)
    viewer.calibration.publish(calibrated(longer, names=["a_1"], covariance=[1e-6]))
    spin(nodes, lambda: viewer.last("result").area > 1.05 * found.area, 60.0)
    assert max(viewer.last("result").deviation) == pytest.approx(1e-3, rel=0.01)
    spin(nodes, lambda: any("up to date" in s.message for m in viewer.told for s in m.status), 60.0)


def test_a_single_link_is_drawn_without_invalid_readings(ros, tmp_path):
    node = make_node(arm=str(short_arm(1, tmp_path)))
    node.on_joints(JointState(name=["joint_1"], position=[float("nan")]))
    assert not node.readings
    node.on_joints(JointState(name=["joint_1"], position=[0.3]))
    node.on_timer()
    wait_until(lambda: not node.maps.busy, 10.0, lambda: None)
    assert not node.maps.failure
    node.close()
    node.destroy_node()


def test_late_subscribers_get_results(spin):
    node = make_node()
    spin(node, lambda: not node.maps.busy, 60.0)
    viewer = Viewer()
    spin([viewer, node], partial(viewer.last, "markers"))
    assert len(viewer.last("markers").markers) == 2  # the boundary and its hole
    spin([viewer, node], partial(viewer.last, "boundary"))
    assert len(viewer.last("boundary").polygon.points) > 100


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({"redundancy": "luck"}, "redundancy is 'luck', expected one of minimum norm"),
        ({"table_corners": [1.0, 2.0]}, "table_corners has 2 numbers, expected 4"),
    ],
)
def test_invalid_settings_are_rejected(ros, settings, error):
    with pytest.raises(ValueError, match=error):
        make_node(**settings)


def test_newer_work_supersedes_and_closing_aborts():
    started, done, given_up = Event(), [], []

    def work(request, progress):
        started.set()
        try:
            while request == "endless":
                progress("turning", 0.5)
        except Superseded:
            given_up.append(request)
            raise
        if request == "impossible":
            raise ValueError("no such arm")
        done.append(request)

    worker = Worker(work)
    worker.submit("endless")
    assert started.wait(10.0)
    worker.submit("short")
    wait_until(lambda: done, 10.0, lambda: None)
    worker.submit("impossible")
    wait_until(lambda: worker.failure == "no such arm", 10.0, lambda: None)
    worker.submit("endless")
    worker.close()
    assert done == ["short"]
    assert given_up[0] == "endless"


@pytest.mark.slow
def test_ellipsoids_are_published_steadily_during_a_map(spin, start):
    """Stamps are 0.1 s apart, within 20 ms, while the default map is computed."""
    viewer = Viewer()
    start("fss_arm_workspace.workspace_node")
    q = arch(paper_arm())[3:]
    spin(viewer, lambda: viewer.joints.get_subscription_count(), 60.0)
    spin(viewer, lambda: viewer.say_posture(q) or viewer.heard["ellipsoids"], 60.0)
    beat = []
    while len(beat) < 60:
        count = len(viewer.heard["ellipsoids"])
        arm = paper_arm().with_kinematics(
            paper_arm().vector()[kinematic_index(4)] * (1 + 1e-3 * len(beat))
        )
        if len(beat) % 10 == 0:  # calibrations follow one another: a map is always being computed
            viewer.calibration.publish(calibrated(arm))
        spin(viewer, lambda count=count: len(viewer.heard["ellipsoids"]) > count)
        beat.append(stamp_ns(viewer.last("ellipsoids").markers[0].header.stamp) * 1e-9)
    gaps = np.diff(beat)
    print(f"largest deviation from 0.1 s: {1e3 * np.abs(gaps - 0.1).max():.1f} ms")
    assert np.abs(gaps - 0.1).max() < 0.02
