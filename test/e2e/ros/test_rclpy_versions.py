"""Every node on an rclpy whose private names differ from those of the installed one.

A node starts, answers a request, receives messages and ends on SIGINT or SIGTERM. All other tests
run on the installed rclpy.
"""

import os
import signal

import pytest
from all_nodes import NODES
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from renamed_rclpy import copy_with_renamed_privates
from running import OWN

from fss_arm_bags.definitions import message_class
from fss_arm_ros.qos import LATCHED
from fss_rehearsal.processes import Nodes

GARBAGE = b"\0\1\0\0"  # no message of any type with a number in it
NOT_THEIRS = ("/parameter_events", "/clock", "/rosout", "/diagnostics")
WITHOUT_CONTENT = ("std_msgs/msg/Empty", "std_msgs/msg/Bool")  # garbage would be a valid one
TIMEOUT = 90.0  # of seventeen nodes that start at once [s]


@pytest.fixture
def renamed(tmp_path, monkeypatch):
    """Have the nodes import a copy of rclpy with other private names."""
    assert "_executor_event" in copy_with_renamed_privates(tmp_path / "copy")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'copy'}:{os.environ['PYTHONPATH']}")


class Client(Node):
    """Asks every node for a parameter, sends it garbage, and reads its diagnostics."""

    def __init__(self):
        super().__init__("client")
        self.reports = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_report, 100)
        self.outputs = {}

    def on_report(self, message):
        for status in message.status:
            self.reports[status.name.lstrip("/")] = {v.key: v.value for v in status.values}

    def rejecting(self, name):
        """Return True if a node reports that it has rejected a message."""
        return any(key.startswith("refused on") for key in self.reports.get(name, ()))

    def topics(self, name):
        """Return the topics and types that a node receives with a rule for their content."""
        found = self.get_subscriber_names_and_types_by_node(name, "/")
        return {
            (topic, kinds[0])
            for topic, kinds in found
            if topic not in NOT_THEIRS and "/_" not in topic and kinds[0] not in WITHOUT_CONTENT
        }

    def send_garbage(self, name):
        """Publish bytes that are no message on each topic that a node receives."""
        for topic, kind in self.topics(name):
            if topic not in self.outputs:
                self.outputs[topic] = self.create_publisher(message_class(kind), topic, LATCHED)
            self.outputs[topic].publish(GARBAGE)


def test_each_node_starts_answers_receives_and_ends(spin, renamed, tmp_path):
    table = {
        **NODES,
        "testbed": (
            "fss_sim",
            "testbed",
            {"ports": [0, 0, 0, 0], "keep_clock": True, "paused": True},
        ),
        "record": ("fss_arm_bags", "record", {"output": tmp_path / "bag"}),
        "view": ("fss_arm_view", "view", {"mode": "file", "file": tmp_path / "view.rrd"}),
    }
    client = Client()
    with Nodes(tmp_path / "logs", print, OWN) as nodes:
        for name, (package, executable, given) in table.items():
            nodes.start(name, package, executable, **given)
        ask = {
            name: client.create_client(GetParameters, f"{name}/get_parameters") for name in table
        }

        def ready():
            for name, process in nodes.processes.items():
                assert process.poll() is None, f"{name} ended: {nodes.last_log_line(name)}"
            return all(one.service_is_ready() for one in ask.values())

        spin(client, ready, timeout=TIMEOUT)
        answers = [
            one.call_async(GetParameters.Request(names=["use_sim_time"])) for one in ask.values()
        ]
        spin(client, lambda: all(answer.done() for answer in answers), timeout=TIMEOUT)

        receiving = [name for name in table if name != "record" and client.topics(name)]
        assert {"arm", "link_1", "kinematic", "navigation", "view"} <= set(receiving)

        def remaining():
            return [name for name in receiving if not client.rejecting(name)]

        client.create_timer(1.0, lambda: [client.send_garbage(name) for name in remaining()])
        spin(client, lambda: not remaining(), timeout=TIMEOUT)
        for k, process in enumerate(nodes.processes.values()):
            process.send_signal((signal.SIGINT, signal.SIGTERM)[k % 2])
        for name, process in nodes.processes.items():
            code = process.wait(TIMEOUT)
            log = (tmp_path / "logs" / f"{name}.log").read_text()
            assert code == 0, log
            assert "Traceback" not in log
