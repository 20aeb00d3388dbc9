"""Event log of all nodes of a configuration, for the operator.

The scripts that start nodes set its file in FSS_EVENTS, write starts and ends of nodes to it, and
show its last lines.
"""

import os
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime

from rclpy.node import Node

from fss_arm_ros.log_line import LogLine


def report(node: Node, lines: Iterable[LogLine]) -> None:
    """Log lines, and those for the operator in the event log, too."""
    log = node.get_logger()
    for line in lines:
        if line.bad:  # rclpy requires one source line per severity
            log.warning(line.words)
        else:
            log.info(line.words)
        if line.for_operator:
            log_event(node, line.words)


def log_event(node: Node, words: str) -> None:
    """Append a line to the event log, if FSS_EVENTS is set; errors of the disk are ignored."""
    if path := os.environ.get("FSS_EVENTS"):
        of = f"{node.get_namespace().strip('/')} " if node.get_namespace() != "/" else ""
        line = f"{datetime.now():%F %T} {of}{words}\n"
        with suppress(OSError), open(path, "a") as log:
            log.write(line)
