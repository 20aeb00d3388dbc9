"""The log of events: what an operator should know, of all nodes of a configuration.

The scripts that start nodes name its file in FSS_EVENTS, write what becomes of the nodes to it
themselves, and show its end.
"""

import os
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from typing import Any

from rclpy.node import Node


def report(node: Node, lines: Iterable[Any]) -> None:
    """Log lines, which have `words`, are `bad` or not, and `for_operator` or not."""
    log = node.get_logger()
    for line in lines:
        if line.bad:  # rclpy wants each severity on a line of its own
            log.warning(line.words)
        else:
            log.info(line.words)
        if line.for_operator:
            tell(node, line.words)


def tell(node: Node, words: str) -> None:
    """Add a line to the log of events, if there is one; a full disk holds nobody up."""
    if path := os.environ.get("FSS_EVENTS"):
        of = f"{node.get_namespace().strip('/')} " if node.get_namespace() != "/" else ""
        line = f"{datetime.now():%F %T} {of}{words}\n"
        with suppress(OSError), open(path, "a") as log:
            log.write(line)
