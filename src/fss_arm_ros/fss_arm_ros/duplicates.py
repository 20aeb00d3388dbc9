"""Check that no other node of the ROS domain has the same name or offers the same services.

A new process discovers only nodes that are running, because a killed node is no longer announced.
Of two that start at the same time, the earlier one stays: each process shows a claim, a hidden node
in a namespace with the name of the node itself. On a busy machine they may start before they see
each other, so each looks again for some seconds, and keeps its claim until then.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rclpy.clock import Clock, ClockType
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter

from fss_arm_ros.common_parameter import ALLOW

DISCOVERY_TIME = 0.4  # after joining the graph, a process knows it [s]
RECHECK_DELAY = 0.1  # to a second check, because a claim appears after its node [s]
REPEAT_PERIOD = 1.0  # of the checks while spinning [s]
REPEATS = 10  # of the checks while spinning; the claims stay until then
CLAIM = "_claim_"


class DuplicateError(ValueError):
    """Another node has the same name or services; the message names it."""


class Claims:
    """Claims of the nodes of a starting process, visible to other processes."""

    def __init__(self) -> None:
        self.name = f"{CLAIM}{time.time_ns():020d}_{os.getpid()}"  # sorted by start
        self.nodes: list[Node] = []
        self.until = 0.0  # by time.monotonic, once this process has joined the graph
        self._duplicates: dict[str, str] = {}  # those of the last check while spinning, by node

    def check_name(self, node: Node, allowed: bool) -> None:
        """Show a claim; raise DuplicateError if another node has this name, unless allowed.

        Without its claim, an allowed duplicate would look older than the node that it is beside.
        """
        path = node.get_fully_qualified_name()
        self.until = self.until or time.monotonic() + DISCOVERY_TIME
        claim = Node(
            self.name,
            namespace=path,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self.nodes.append(claim)
        if allowed:
            return
        time.sleep(max(0.0, self.until - time.monotonic()))
        self._refuse(node, lambda: self._is_before(node, path) and f"{path} is there already")

    def check_services(self, node: Node) -> None:
        """Raise DuplicateError if another node offers one of this node's services."""
        self._refuse(node, lambda: self._offered(node))

    def check_again(self, nodes: Sequence[Node]) -> None:
        """Raise DuplicateError if another node has been a duplicate since the last such check."""
        before, self._duplicates = self._duplicates, {}
        for node in nodes:
            path = node.get_fully_qualified_name()
            found = self._is_before(node, path) and f"{path} is there already"
            if words := found or self._offered(node):
                self._duplicates[path] = words
                if before.get(path) == words:
                    raise self._error(node, words)

    def close(self) -> None:
        """Remove the claims."""
        while self.nodes:
            self.nodes.pop().destroy_node()

    def _refuse(self, node: Node, other: Callable[[], str | bool]) -> None:
        if other():
            time.sleep(RECHECK_DELAY)
            if words := other():
                raise self._error(node, words)

    @staticmethod
    def _error(node: Node, words: str | bool) -> DuplicateError:
        domain = node.context.get_domain_id()
        return DuplicateError(f"{words} in ROS domain {domain}; -p {ALLOW}:=true allows it")

    def _is_before(self, node: Node, path: str) -> bool:
        """Return True if another node of that name started before this process."""
        known = node.get_node_names_and_namespaces()
        own = path == node.get_fully_qualified_name()
        others = sum(_join(space, name) == path for name, space in known) - own
        claims = [name for name, space in known if space == path and name.startswith(CLAIM)]
        return others > len(claims) - own or any(claim < self.name for claim in claims)

    def _offered(self, node: Node) -> str:
        """Return a sentence naming another node that offers a service of this one, or ''."""
        own = node.get_fully_qualified_name()
        for service in _services(node, own):
            if node.count_services(service) < 2:
                continue
            known = node.get_node_names_and_namespaces()
            for path in {_join(space, name) for name, space in known} - {own}:
                if service in _services(node, path) and self._is_before(node, path):
                    return f"{path} offers {service.partition('/_action/')[0]} already"
        return ""


_claims: Claims | None = None  # set while `run` creates the nodes


@contextmanager
def looking() -> Iterator[None]:
    """Check for duplicates of nodes that are created in this context; tests create them outside."""
    global _claims
    _claims = Claims()
    try:
        yield
    finally:
        _claims.close()
        _claims = None


def check_name(node: Node, allowed: bool = False) -> None:
    """Wait for discovery, then look for another node of the same name.

    Raises:
        DuplicateError: another node has the name, and this is not allowed.
    """
    # A node without parameter services only reads parameters and disturbs no other node. The graph
    # does not help: it may describe another node of this name, whose services are not known yet.
    if _claims and any(s.service_name.endswith("/get_parameters") for s in node.services):
        _claims.check_name(node, allowed)


def check_services(nodes: Sequence[Node]) -> None:
    """Look for other nodes that offer the same services, before these nodes spin.

    A timer of the first node looks again for nodes that started at the same time; it raises
    DuplicateError into the executor.

    Raises:
        DuplicateError: another node offers one of them.
    """
    claims = _claims
    checked = [n for n in nodes if n.has_parameter(ALLOW) and not n.get_parameter(ALLOW).value]
    if claims is None or not claims.nodes:
        return
    for node in checked:
        claims.check_services(node)

    repeats = iter(range(REPEATS))

    def check_again() -> None:
        if next(repeats, None) is None:
            timer.cancel()
            claims.close()
        else:
            claims.check_again(checked)

    steady = Clock(clock_type=ClockType.STEADY_TIME)
    timer = nodes[0].create_timer(REPEAT_PERIOD, check_again, clock=steady)


def _services(node: Node, path: str) -> set[str]:
    """Return the services of a node; empty if the node has gone."""
    namespace, _, name = path.rpartition("/")
    try:
        found = node.get_service_names_and_types_by_node(name, namespace or "/")
    except NodeNameNonExistentError:
        return set()
    return {service for service, _ in found}


def _join(namespace: str, name: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
