"""Faults in the node graph: what the nodes do, and that a bag tells what was wrong."""

from pathlib import Path
from threading import Event

import numpy as np
import pytest
from rclpy.node import Node
from running import wait_until
from std_srvs.srv import SetBool, Trigger

from fss_arm_bags.reader import open_bags
from fss_arm_model.description_file import load
from fss_arm_model.layout import kinematic_index
from fss_arm_msgs.msg import KinematicCalibration, LinkTelemetry, SimFaults
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED, SENSOR

ROOT = Path(__file__).parents[3]
SCRIPT = """
- {at: 1.0, part: link_1, fault: loss, value: 0.2}
- {at: 2.0, part: link_1, fault: jitter, value: 0.05}
- {at: 4.0, part: link_2, fault: reset, duration: 0.5}
- {at: 1.0, part: link_3, fault: reordering, value: 0.2}
- {at: 1.0, part: link_4, fault: corruption, value: 0.2}
- {at: 1.0, part: end_effector, fault: occlusion, value: 0.1}
"""


class Operator(Node):
    """What links report, and the services that a person calls."""

    def __init__(self):
        super().__init__("operator")
        self.telemetry = {i: [] for i in range(1, 5)}
        for i, heard in self.telemetry.items():
            self.create_subscription(LinkTelemetry, f"link_{i}/telemetry", heard.append, SENSOR)
        self.results = []
        self.create_subscription(
            KinematicCalibration, "calibration/kinematic", self.results.append, LATCHED
        )
        self.arm = self.create_client(SetBool, "arm/enable")
        self.solve = self.create_client(Trigger, "kinematic/solve")
        self.asked = None

    def armed(self):
        return all(heard and heard[-1].armed for heard in self.telemetry.values())

    def rearm(self):
        """Arm whenever a link is not."""
        if self.armed() or not self.arm.service_is_ready():
            return
        if self.asked is None or self.asked.done():
            self.asked = self.arm.call_async(SetBool.Request(data=True))


def parameters(**values):
    given = []
    for name, value in values.items():
        given += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    return "--ros-args", *given


@pytest.fixture
def graph(start, tmp_path):
    """graph(**of the testbed): test bed, drivers and recorder, as fast as the drivers follow."""

    def begin(**settings):
        (tmp_path / "faults.yaml").write_text(SCRIPT)
        terminals = [str(tmp_path / f"tty_{i}") for i in range(1, 5)]
        start(
            "fss_sim.testbed_node",
            *parameters(
                keep_clock=True, speed=0.0, faults=tmp_path / "faults.yaml", terminals=terminals,
                **settings,
            ),
        )  # fmt: skip
        wait_until(lambda: all((tmp_path / f"tty_{i}").exists() for i in range(1, 5)), 30, nap)
        urls = [f"serial://{path}?baud=115200" for path in terminals]
        start("fss_arm_driver.link_node", *parameters(urls=urls, use_sim_time=True))
        return start(
            "fss_arm_bags.record_node", *parameters(output=tmp_path / "bag", use_sim_time=True)
        )

    return begin


def nap():
    Event().wait(0.05)


def test_drivers_go_on_and_the_bag_tells_what_was_wrong(graph, spin, tmp_path):
    record, operator = graph(), Operator()
    telemetry = operator.telemetry
    spin(operator, lambda: all(telemetry.values()), 60.0)
    first = telemetry[1][0].boot  # of all links
    spin(operator, lambda: any(m.boot != first for m in telemetry[2]), 60.0)
    told = []
    operator.create_subscription(SimFaults, "sim/faults", told.append, LATCHED)
    spin(operator, lambda: all(len(heard) > 60 for heard in operator.telemetry.values()), 60.0)
    spin(operator, lambda: operator.count_subscribers("sim/faults") == 2, 60.0)
    told.clear()
    spin(operator, lambda: len(told) > 1, 60.0)  # the recorder hears it too
    assert all(m.boot == first for m in telemetry[1])
    assert record.stop() == 0, record.output
    with open_bags(tmp_path / "bag") as bags:
        topics = {"/sim/faults", "/vicon/fss/fss", "/vicon/end_effector/end_effector"}
        messages = {topic: [] for topic in topics}
        for topic, _, _, message in bags.messages(topics):
            messages[topic].append(message)
    assert messages["/sim/faults"][0].script == SCRIPT
    last = messages["/sim/faults"][-1]
    assert ("link_1", "loss", 0.2) in zip(last.part, last.fault, last.value, strict=True)
    stamps = np.array([stamp_ns(m.header.stamp) for m in messages["/vicon/fss/fss"]])
    assert set(np.diff(stamps)) == {10_000_000}
    occluded = [m.pose.orientation.w == 0.0 for m in messages["/vicon/end_effector/end_effector"]]
    assert 0.0 < np.mean(occluded) < 0.2


@pytest.mark.slow
def test_the_experiment_ends_well_under_faults(graph, start, spin):
    graph(arm=ROOT / "config/truth.yaml", preset="paper")
    clock = {"use_sim_time": True}
    start("fss_arm_driver.arm_node", *parameters(**clock))
    start(
        "fss_arm_calib.programs:kinematic",
        *parameters(arm=ROOT / "config/cad.yaml", **clock),
    )
    experiment = start("fss_arm_calib.experiment.experiment_node", *parameters(**clock))
    operator = Operator()

    def ended():
        operator.rearm()
        return experiment.process.poll() is not None

    spin(operator, ended, 300.0)
    assert experiment.process.returncode == 0, experiment.output
    operator.results.clear()
    solved = operator.solve.call_async(Trigger.Request())
    spin(operator, lambda: solved.done() and operator.results, 60.0)
    result = operator.results[-1]
    found = result.calibration
    assert found.verdict == found.PASS, found.reason
    true = load(ROOT / "config/truth.yaml").vector()[kinematic_index(4)]
    true = true[2:] if len(found.values) == len(true) - 2 else true  # one length for three
    sigma = np.sqrt(np.diag(np.reshape(found.covariance, (len(true), -1))))
    assert (np.abs(found.values - true) < 3 * sigma).all()
