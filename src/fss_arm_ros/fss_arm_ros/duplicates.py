"""That a node is alone: no other of its name in the ROS domain, nobody else with its services.

A process that has just begun hears only of nodes that live, as one that was killed announces
itself no more: whom it finds in the graph is there. Of two that begin together the earlier one
stays: each shows its claim, a hidden node in a namespace that is called as the node itself.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter

from fss_arm_ros.program import ABOUT as ABOUT
from fss_arm_ros.program import ALLOW as ALLOW

WINDOW = 0.4  # by then a process that has joined the graph knows it [s]
AGAIN = 0.1  # to the second check before giving way, as a claim comes after its node [s]
CLAIM = "_claim_"


class DuplicateError(ValueError):
    """Another node is what this one would be; the message names it."""


class Claims:
    """What the nodes of a process that begins will be, for others to see."""

    def __init__(self) -> None:
        self.name = f"{CLAIM}{time.time_ns():020d}_{os.getpid()}"  # in the order of begin
        self.nodes: list[Node] = []
        self.until = 0.0  # by time.monotonic, once this process has joined the graph

    def check_name(self, node: Node) -> None:
        """Raise DuplicateError if there is another node of this name."""
        path = node.get_fully_qualified_name()
        self.until = self.until or time.monotonic() + WINDOW
        claim = Node(
            self.name, namespace=path, use_global_arguments=False, enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )  # fmt: skip
        self.nodes.append(claim)
        time.sleep(max(0.0, self.until - time.monotonic()))
        self._refuse(node, lambda: self._is_before(node, path) and f"{path} is there already")

    def check_services(self, node: Node) -> None:
        """Raise DuplicateError if another node offers one of this node's services."""
        self._refuse(node, lambda: self._offered(node))

    def close(self) -> None:
        """Claim nothing any more."""
        for node in self.nodes:
            node.destroy_node()

    def _refuse(self, node: Node, other: Callable[[], str | bool]) -> None:
        if other():
            time.sleep(AGAIN)
            if words := other():
                domain = node.context.get_domain_id()
                raise DuplicateError(f"{words} in ROS domain {domain}; -p {ALLOW}:=true allows it")

    def _is_before(self, node: Node, path: str) -> bool:
        """Whether another node of that name is there that has not begun after this process."""
        known = node.get_node_names_and_namespaces()
        own = path == node.get_fully_qualified_name()
        others = sum(_join(space, name) == path for name, space in known) - own
        claims = [name for name, space in known if space == path and name.startswith(CLAIM)]
        return others > len(claims) - own or any(claim < self.name for claim in claims)

    def _offered(self, node: Node) -> str:
        """Who offers a service of this node, in words, if anybody does."""
        own = node.get_fully_qualified_name()
        for service in _services(node, own):
            if node.count_services(service) < 2:
                continue
            known = node.get_node_names_and_namespaces()
            for path in {_join(space, name) for name, space in known} - {own}:
                if service in _services(node, path) and self._is_before(node, path):
                    return f"{path} offers {service.partition('/_action/')[0]} already"
        return ""


_claims: Claims | None = None  # while `run` makes the nodes


@contextmanager
def looking() -> Iterator[None]:
    """Within, nodes look for others as they are declared; elsewhere, as in tests, they do not."""
    global _claims
    _claims = Claims()
    try:
        yield
    finally:
        _claims.close()
        _claims = None


def check_name(node: Node) -> None:
    """Wait until others are known, and look for a node of the same name.

    Raises:
        DuplicateError: there is one.
    """
    path = node.get_fully_qualified_name()
    # A node without parameter services only reads parameters, and is in nobody's way.
    if _claims and f"{path}/get_parameters" in _services(node, path):
        _claims.check_name(node)


def check_services(nodes: Sequence[Node]) -> None:
    """Look for others that offer what these nodes do, once they are made and before they spin.

    Raises:
        DuplicateError: there is one.
    """
    for node in nodes:
        if _claims and node.has_parameter(ALLOW) and not node.get_parameter(ALLOW).value:
            _claims.check_services(node)


def _services(node: Node, path: str) -> set[str]:
    """The services of a node; none if it is gone."""
    namespace, _, name = path.rpartition("/")
    try:
        found = node.get_service_names_and_types_by_node(name, namespace or "/")
    except NodeNameNonExistentError:
        return set()
    return {service for service, _ in found}


def _join(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
