"""Operator of the simulated test bed, in a ROS domain where no other node drives links."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import SetBool

from fss_arm_msgs.msg import LinkCommand, LinkTelemetry, SimTruth
from fss_arm_ros.qos import COMMAND, SENSOR
from fss_rehearsal.domain import Domain, reserve
from fss_rehearsal.processes import RehearsalError

LINKS = 4
DISCOVERY_TIME = 1.0  # discovery time [s]; nodes on this computer are found within a few tenths
ANSWER_TIMEOUT = 2.0  # [s]
LINK_NUMBERS = range(1, 13)  # possible link numbers
DRIVER_NAMES = {
    "/arm/enable",
    *(f"/link_{i}/{kind}" for i in LINK_NUMBERS for kind in ("arm", "telemetry")),
}


@contextmanager
def isolated_domain() -> Iterator[Domain]:
    """Enter a ROS domain without other nodes, whatever is exported, and initialize rclpy.

    Raises:
        OSError: no domain is free.
    """
    for domain in reserve():
        domain.enter()
        rclpy.init(args=["--ros-args", "--enclave", domain.enclave])
        if is_alone(domain):
            yield domain
            return
        rclpy.shutdown()


def is_alone(domain: Domain) -> bool:
    """Return True if no other node is discovered in the domain."""
    node, end = Node("operator"), time.monotonic() + DISCOVERY_TIME
    while not (foreign := list(foreign_nodes(node, domain))) and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    node.destroy_node()
    return not foreign


def foreign_nodes(node: Node, domain: Domain) -> Iterator[tuple[str, str, str]]:
    """Yield name, namespace and enclave ('' if still unknown) of each foreign node."""
    for name, space, enclave in node.get_node_names_and_namespaces_with_enclaves():
        if enclave != domain.enclave:
            yield name, space, enclave


class Operator(Node):
    """Node that monitors which links are armed, and arms them if no other node drives links."""

    TIMEOUT = 60.0  # default timeout of each wait [s]

    def __init__(self, domain: Domain, links: int = LINKS, **options: Any) -> None:
        super().__init__("operator", **options)
        self.domain = domain
        self.armed = dict.fromkeys(range(1, links + 1), False)
        for i in self.armed:
            self.create_subscription(LinkTelemetry, f"link_{i}/telemetry", self.on_link, SENSOR)
        self.arm = self.create_client(SetBool, "arm/enable")
        self.response, self.retry_at = Future(), 0.0
        self.parameter_client = self.create_client(SetParameters, "testbed/set_parameters")

    @property
    def disarmed(self) -> str:
        """Links that are not armed, such as `links 2, 3`; empty: all are armed."""
        numbers = [str(i) for i, armed in self.armed.items() if not armed]
        return f"link{'s' * (len(numbers) > 1)} {', '.join(numbers)}" if numbers else ""

    def now(self) -> int:
        """Return the current time [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def wait(self, condition: Callable[[], bool], error: str, timeout: float = 0.0) -> None:
        """Spin until the condition holds.

        Raises:
            RehearsalError: it does not hold within `timeout` [s] (0: TIMEOUT).
        """
        limit = timeout or self.TIMEOUT
        deadline = time.monotonic() + limit
        while not condition():
            if time.monotonic() > deadline:
                raise RehearsalError(f"{error} (waited {limit:g} s)")
            rclpy.spin_once(self, timeout_sec=0.02)

    def wait_until(self, time_ns: int) -> None:
        """Spin until a time [ns].

        Raises:
            RehearsalError: the clock does not reach it within TIMEOUT.
        """
        self.wait(lambda: self.now() > time_ns, "the clock does not advance")

    def set_faults(self, faults: Mapping[str, float]) -> int:
        """Set faults of the test bed through its parameters; return when it was done [ns]."""
        ready = self.parameter_client.service_is_ready
        self.wait(ready, "the test bed's parameter service is not available")
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in faults.items()
        ]
        response = self.parameter_client.call_async(SetParameters.Request(parameters=parameters))
        self.wait(response.done, "the test bed does not respond")
        return self.now()

    def on_link(self, message: LinkTelemetry) -> None:
        """Store whether the link is armed."""
        self.armed[message.link] = message.armed

    def keep_armed(self) -> None:
        """Request arming if a link is not armed.

        Raises:
            RehearsalError: a foreign node drives links in this domain.
        """
        answered = self.response.done() or time.monotonic() > self.retry_at
        needed = not all(self.armed.values()) and self.arm.service_is_ready()
        if self.is_only_driver() and answered and needed:
            self.response = self.arm.call_async(SetBool.Request(data=True))
            self.retry_at = time.monotonic() + ANSWER_TIMEOUT

    def is_only_driver(self) -> bool:
        """Return True if all nodes that drive links are known to belong to this rehearsal.

        Raises:
            RehearsalError: one of them belongs to another enclave.
        """
        foreign = [
            node for node in foreign_nodes(self, self.domain) if self.drives_links(*node[:2])
        ]
        for name, space, enclave in foreign:
            if enclave:
                raise RehearsalError(
                    f"node {space.rstrip('/')}/{name} in ROS domain {self.domain.number} drives "
                    "links, too, but does not belong to this rehearsal: stop it"
                )
        return not foreign

    def drives_links(self, name: str, space: str) -> bool:
        """Return True if the node drives links, or offers to arm them."""
        with suppress(NodeNameNonExistentError):  # it has just ended
            offered = self.get_publisher_names_and_types_by_node(name, space)
            offered += self.get_service_names_and_types_by_node(name, space)
            return any(kind in DRIVER_NAMES for kind, _ in offered)
        return False


class Mover(Operator):
    """Operator that commands all joints all the time, like a program that ignores telemetry."""

    GOALS = (0.9, -0.9, 0.9, -0.9)  # joint angles [rad]
    # Commanded rate; rate above which a joint moves [rad/s].
    COMMANDED_RATE, MOVING_RATE = 0.05, 0.03

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain)
        self.rates = np.zeros(LINKS)
        self.create_subscription(SimTruth, "sim/truth", self.on_truth, 1)
        self.commands = {
            i: self.create_publisher(LinkCommand, f"link_{i}/command", COMMAND) for i in self.armed
        }
        self.homing: set[int] = set()  # links that are commanded to home instead
        self.create_timer(0.2, self.command)
        self.arming = False  # True: arm links that are not armed
        self.create_timer(0.5, lambda: self.keep_armed() if self.arming else None)

    def on_truth(self, message: SimTruth) -> None:
        """Store the absolute joint rates."""
        self.rates = np.abs(message.qd[3:])

    def command(self) -> None:
        """Command each joint to its goal, or to home."""
        for (i, publisher), goal in zip(self.commands.items(), self.GOALS, strict=True):
            command = LinkCommand(mode=LinkCommand.POSITION, set_point=goal)
            command.max_velocity, command.time_to_live = self.COMMANDED_RATE, 60.0
            if i in self.homing:
                command = LinkCommand(mode=LinkCommand.HOME, time_to_live=2.0)
            publisher.publish(command)

    def arm_and_turn(self) -> int:
        """Arm all links and wait until they turn; return when they do [ns]."""
        self.arming = True
        self.wait(lambda: all(self.armed.values()), "not all links become armed")
        self.wait(lambda: bool((self.rates > self.MOVING_RATE).all()), "not all joints turn")
        self.arming = False
        return self.now()
