"""Every node on an rclpy whose private names differ from those of the installed one.

A node starts, answers a request, receives messages and ends on SIGINT or SIGTERM. All other tests
run on the installed rclpy.
"""

import os
import signal
from itertools import cycle

import pytest
from all_nodes import NODES
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node, NodeNameNonExistentError
from renamed_rclpy import copy_with_renamed_privates
from running import OWN

from fss_arm_bags.definitions import message_class
from fss_arm_bags.inspection import is_sound
from fss_arm_bags.reader import find_bags
from fss_arm_ros.qos import LATCHED
from fss_rehearsal.processes import Nodes

GARBAGE = b"\0\1\0\0"  # no message of any type with a number in it
NOT_THEIRS = ("/parameter_events", "/clock", "/rosout", "/diagnostics")
WITHOUT_CONTENT = ("std_msgs/msg/Empty", "std_msgs/msg/Bool")  # garbage would be a valid one
REJECTS_NOTHING = {"record"}  # nodes without a topic whose content they check
TIMEOUT = 240.0  # of all nodes [s]


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
        try:
            found = self.get_subscriber_names_and_types_by_node(name, "/")
        except NodeNameNonExistentError:  # its services were discovered before its name
            return set()
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
    """Each is ended as soon as it has done the rest, while others still start."""
    table = {
        **NODES,
        "workspace": ("fss_arm_workspace", "workspace", {"cell": 0.2, "directions": 12}),
        "testbed": (
            "fss_sim",
            "testbed",
            {"ports": [0, 0, 0, 0], "keep_clock": True, "paused": True},
        ),
        "record": ("fss_arm_bags", "record", {"output": tmp_path / "bag"}),
        "view": ("fss_arm_view", "view", {"mode": "file", "file": tmp_path / "view.rrd"}),
    }
    signals = dict(zip(table, cycle((signal.SIGINT, signal.SIGTERM)), strict=False))
    client, answers = Client(), {}
    with Nodes(tmp_path / "logs", print, OWN) as nodes:
        for name, (package, executable, given) in table.items():
            nodes.start(name, package, executable, **given)
        ask = {
            name: client.create_client(GetParameters, f"{name}/get_parameters") for name in table
        }

        def awaits_garbage(name):
            return name not in REJECTS_NOTHING and not client.rejecting(name)

        def has_ended(name, process):
            """Take a node a step further; return True once it has ended after its signal."""
            code = process.poll()
            if name not in signals:
                return code is not None
            assert code is None, f"{name} ended: {nodes.last_log_line(name)}"
            if name not in answers and ask[name].service_is_ready():
                request = GetParameters.Request(names=["use_sim_time"])
                answers[name] = ask[name].call_async(request)
            if name in answers and answers[name].done() and not awaits_garbage(name):
                process.send_signal(signals.pop(name))
            return False

        def remaining():
            return [n for n, process in nodes.processes.items() if not has_ended(n, process)]

        def send_garbage():
            for name in filter(awaits_garbage, signals.keys() & answers.keys()):
                client.send_garbage(name)

        client.create_timer(0.3, send_garbage)
        spin(client, lambda: not remaining(), timeout=TIMEOUT)
        for name, process in nodes.processes.items():
            log = (tmp_path / "logs" / f"{name}.log").read_text()
            assert process.returncode == 0, log
            assert "Traceback" not in log
    assert all(map(is_sound, find_bags(tmp_path / "bag")))
