"""The person at the test bed, in a ROS domain where nobody else drives links."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import rclpy
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.task import Future
from std_srvs.srv import SetBool

from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR
from fss_sim.rehearsal.domain import Domain, reserve
from fss_sim.rehearsal.processes import RehearsalError

LINKS = 4
DISCOVERY = 1.0  # of others; who is on this computer answers within a few tenths [s]
ANSWER_TIMEOUT = 2.0  # [s]
NUMBERS = range(1, 13)  # that a link may have
DRIVERS = {"/arm/enable", *(f"/link_{i}/{what}" for i in NUMBERS for what in ("arm", "telemetry"))}


@contextmanager
def own_domain() -> Iterator[Domain]:
    """A ROS domain where nobody is, whatever is exported; entered, with rclpy initialized.

    Raises:
        OSError: there is none.
    """
    for domain in reserve():
        domain.enter()
        rclpy.init(args=["--ros-args", "--enclave", domain.enclave])
        if is_alone(domain):
            yield domain
            return
        rclpy.shutdown()


def is_alone(domain: Domain) -> bool:
    """Whether nobody answers."""
    node, end = Node("operator"), time.monotonic() + DISCOVERY
    while not (others := list(strangers(node, domain))) and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    node.destroy_node()
    return not others


def strangers(node: Node, domain: Domain) -> Iterator[tuple[str, str, str]]:
    """Name, namespace and enclave of each node of others; '' is an enclave not heard of yet."""
    for name, space, enclave in node.get_node_names_and_namespaces_with_enclaves():
        if enclave != domain.enclave:
            yield name, space, enclave


class Operator(Node):
    """Sees which links are armed, and arms them while nobody else drives links here."""

    def __init__(self, domain: Domain, **options: Any) -> None:
        super().__init__("operator", **options)
        self.domain = domain
        self.armed = dict.fromkeys(range(1, LINKS + 1), False)
        for i in self.armed:
            self.create_subscription(LinkTelemetry, f"link_{i}/telemetry", self.on_link, SENSOR)
        self.arm = self.create_client(SetBool, "arm/enable")
        self.answer, self.due = Future(), 0.0

    def on_link(self, message: LinkTelemetry) -> None:
        """Whether the link is armed."""
        self.armed[message.link] = message.armed

    def keep_armed(self) -> None:
        """Ask for it where a link is not armed.

        Raises:
            RehearsalError: somebody else drives links here.
        """
        answered = self.answer.done() or time.monotonic() > self.due
        wanted = not all(self.armed.values()) and self.arm.service_is_ready()
        if self.drives_alone() and answered and wanted:
            self.answer = self.arm.call_async(SetBool.Request(data=True))
            self.due = time.monotonic() + ANSWER_TIMEOUT

    def drives_alone(self) -> bool:
        """Whether all who drive links here are known to be of this rehearsal.

        Raises:
            RehearsalError: somebody is not.
        """
        others = [one for one in strangers(self, self.domain) if self.drives(*one[:2])]
        for name, space, enclave in others:
            if enclave:
                raise RehearsalError(
                    f"node {space.rstrip('/')}/{name} in ROS domain {self.domain.number} drives "
                    "links, too, and is not of this rehearsal"
                )
        return not others

    def drives(self, name: str, space: str) -> bool:
        """Whether the node drives links, or offers to arm them."""
        with suppress(NodeNameNonExistentError):  # it has just ended
            offered = self.get_publisher_names_and_types_by_node(name, space)
            offered += self.get_service_names_and_types_by_node(name, space)
            return any(what in DRIVERS for what, _ in offered)
        return False
