"""Reception of large goals in a thread of its own.

rclpy converts a whole goal to Python objects before it calls the node, which takes some 25 us per
point of a trajectory. In the node's executor, a large goal would delay everything else by seconds;
in another thread, the two take turns.
"""

from collections.abc import Sequence
from threading import Thread, current_thread
from typing import Any

from rclpy.action import ActionServer
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from fss_arm_ros.subscriptions import SubscriptionThread, Topic


class ThreadGroup(CallbackGroup):
    """Callback group of entities that are executed in one thread only."""

    def __init__(self, thread: Thread) -> None:
        super().__init__()
        self._thread = thread

    def can_execute(self, entity: Any) -> bool:
        """Return True in the group's thread."""
        return current_thread() is self._thread

    def beginning_execution(self, entity: Any) -> bool:
        """Return True: one thread cannot execute two callbacks at a time."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class GoalThread(SubscriptionThread):
    """Thread that receives goals of `node`: by topics, and by action servers given to `serve`.

    Args:
        node: the node whose goals these are; call `close` before it is destroyed.
        topics: as of SubscriptionThread.
    """

    def __init__(self, node: Node, topics: Sequence[Topic]) -> None:
        super().__init__(node, topics, "goals")
        self.group = ThreadGroup(self)
        self._servers: list[ActionServer] = []

    def serve(self, server: ActionServer) -> None:
        """Receive the requests to an action server of `node`, made with the callback group `group`.

        Its goal and cancel callbacks run in this thread, its goals in the executor of `node`.
        """
        self._servers.append(server)
        self._receiver.add_waitable(server)

    def close(self) -> None:
        """End the thread, and destroy the servers."""
        super().close()
        while self._servers:
            self._servers.pop().destroy()
