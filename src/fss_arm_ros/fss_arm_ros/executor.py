"""The executor that nodes spin in: rclpy's, with turns that cost a fraction.

rclpy (7.1) gathers anew at each turn all that a node has, hands over one message of each
subscription as a task, and lets each task wake it twice: some turns for each message, of some
tenths of a millisecond. Here a node's entities are gathered when they change, a turn hands over all
messages that have come, and they and the timers are plain calls. While time is simulated, where
/clock alone calls for up to thousands of turns a second, turns keep a distance.
"""

import time
from collections.abc import Callable, Coroutine, Iterable
from inspect import iscoroutine
from itertools import chain
from typing import Any

from rclpy.event_handler import EventHandler
from rclpy.executors import (
    ExternalShutdownException,
    SingleThreadedExecutor,
    TimeoutObject,
    timeout_sec_to_nsec,
)
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities

from fss_arm_ros.subscriptions import OutsideExecutors

# rclpy keeps these classes in its extension and offers no public names for them.
from rclpy._rclpy_pybind11 import InvalidHandle, WaitSet  # isort: skip

BATCH = 64  # messages of one subscription in a turn, so that others have theirs
QUEUE = 10_000  # before a request, which may be about all that has come by then
RARELY = 1.0  # between looks at the middleware's own events, as a partner whose QoS differs [s]
PAUSE = 0.002  # from one turn to the next at least, in simulated time [s]


class Gathered:
    """What nodes have to wait for, but what is handled outside executors.

    Args:
        nodes: whose entities.
        guards: the executor's own.
        context: the executor's.
    """

    def __init__(self, nodes: Iterable[Node], guards: Iterable[Any], context: Any) -> None:
        def all_of(name: str) -> list[Any]:
            entities = chain(*(getattr(node, name) for node in nodes))
            return [e for e in entities if not isinstance(e.callback_group, OutsideExecutors)]

        self.nodes = tuple(nodes)
        self.subscriptions, self.timers = all_of("subscriptions"), all_of("timers")
        self.clients, self.services = all_of("clients"), all_of("services")
        self.guards, self.waitables = all_of("guards"), all_of("waitables")
        # Of each publisher and subscription some, and hardly ever one is ready.
        self.often = [each for each in self.waitables if not isinstance(each, EventHandler)]
        self._looked = 0.0
        self._by_pointer = {
            entity.handle.pointer: entity
            for entity in chain(
                self.subscriptions, self.timers, self.clients, self.services, self.guards
            )
        }
        self._own = [guard.handle for guard in guards]
        counts = NumberOfEntities(
            len(self.subscriptions),
            len(self.guards) + len(self._own),
            len(self.timers),
            len(self.clients),
            len(self.services),
        )
        for waitable in self.waitables:
            counts += waitable.get_num_entities()
        self._waiting = WaitSet(
            counts.num_subscriptions,
            counts.num_guard_conditions,
            counts.num_timers,
            counts.num_clients,
            counts.num_services,
            counts.num_events,
            context.handle,
        )

    def wait(self, timeout: int, may: Callable[[Any], bool] | None) -> None:
        """Wait until something is ready, for so many nanoseconds at most, for ever if negative.

        Args:
            timeout: [ns].
            may: which entities to wait for; for all without it.
        """
        waiting = self._waiting
        waiting.clear_entities()
        for entities, add in (
            (self.subscriptions, waiting.add_subscription),
            (self.timers, waiting.add_timer),
            (self.clients, waiting.add_client),
            (self.services, waiting.add_service),
            (self.guards, waiting.add_guard_condition),
        ):
            for entity in filter(may, entities) if may else entities:
                add(entity.handle)
        for guard in self._own:
            waiting.add_guard_condition(guard)
        waitables = self.often
        if self._looked + RARELY <= (now := time.monotonic()):
            waitables, self._looked = self.waitables, now
        self._waited = list(filter(may, waitables)) if may else waitables
        for waitable in self._waited:
            waitable.add_to_wait_set(waiting)
        waiting.wait(timeout)

    def ready(self, kind: str) -> list[Any]:
        """Those of a kind that are, after waiting."""
        pointers = self._waiting.get_ready_entities(kind)
        return [self._by_pointer[each] for each in pointers if each in self._by_pointer]

    def ready_waitables(self) -> list[Any]:
        """Those that are, after waiting."""
        return [waitable for waitable in self._waited if waitable.is_ready(self._waiting)]


class BatchExecutor(SingleThreadedExecutor):
    """Hands over all that has come in a turn, in which `spin_once` differs from rclpy's.

    A request is answered after the messages that came before it. No entity may be destroyed by
    another thread than the executor's while it spins.
    """

    _tasks: list[Any]

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._turned = 0.0
        self._gathered: Gathered | None = None

    def wake(self) -> None:
        """Wake, as entities were created or destroyed."""
        self._gathered = None
        super().wake()

    def add_node(self, node: Node) -> bool:
        """Add a node, whose callbacks are called from now on."""
        self._gathered = None
        return super().add_node(node)

    def remove_node(self, node: Node) -> None:
        """Remove a node."""
        self._gathered = None
        super().remove_node(node)

    def _spin_once_impl(
        self,
        timeout_sec: float | TimeoutObject | None = None,
        wait_condition: Callable[[], bool] = lambda: False,
    ) -> None:
        """Take a turn: wait until something is ready, for so long at most, and do all of it."""
        if self._is_shutdown or wait_condition():
            return
        if self._gathered is None:
            own = (self._guard, self._sigint_gc)
            self._gathered = Gathered(self.get_nodes(), own, self._context)
        gathered = self._gathered
        self._keep_distance(gathered.nodes)
        timeout = timeout_sec.timeout if isinstance(timeout_sec, TimeoutObject) else timeout_sec
        gathered.wait(timeout_sec_to_nsec(timeout), self.can_execute if self._tasks else None)
        if self._is_shutdown:
            return
        if not self._context.ok():
            raise ExternalShutdownException()
        for waitable in gathered.ready_waitables():
            self._make_handler(waitable, None, self._take_waitable)
        for timer in gathered.ready("timer"):
            self._call_timer(timer)
        for subscription in gathered.ready("subscription"):
            self._hand_over(subscription, BATCH)
        for guard in gathered.ready("guard_condition"):
            self._call(guard.callback)
        for client in gathered.ready("client"):
            self._make_handler(client, None, self._take_client)
        for service in gathered.ready("service"):
            self._make_handler(service, None, self._take_service)
        self._go_on()

    def _keep_distance(self, nodes: Iterable[Node]) -> None:
        rest = self._turned + PAUSE - time.monotonic()
        if rest > 0.0 and any(node.get_clock().ros_time_is_active for node in nodes):
            time.sleep(rest)
        self._turned = time.monotonic()

    def _call_timer(self, timer: Any) -> None:
        try:
            with timer.handle:
                if not timer.handle.is_timer_ready():  # it was cancelled meanwhile
                    return
                timer.handle.call_timer()
        except InvalidHandle:  # destroyed in this turn
            return
        self._call(timer.callback)

    def _hand_over(self, subscription: Subscription, most: int) -> None:
        """Hand over the messages that have come, but not more than so many."""
        handle, alone = subscription.handle, subscription.CallbackType.MessageOnly
        for _ in range(most):
            try:
                with handle:
                    taken = handle.take_message(subscription.msg_type, subscription.raw)
            except InvalidHandle:  # destroyed in this turn
                return
            if taken is None:
                return
            self._call(
                subscription.callback,
                *(taken[:1] if subscription._callback_type is alone else taken),
            )

    def _call(self, callback: Callable[..., Any], *args: Any) -> None:
        answer = callback(*args)
        if answer is not None and iscoroutine(answer):
            self.create_task(answer)

    def _take_service(self, service: Any) -> Callable[[], Coroutine[Any, Any, None]]:
        take = super()._take_service

        async def answer() -> None:
            for subscription in self._gathered.subscriptions if self._gathered else ():
                self._hand_over(subscription, QUEUE)
            if step := take(service):
                await step()

        return answer

    def _go_on(self) -> None:
        """Go on with what is under way; what went wrong in it is raised."""
        for task, *_ in tuple(self._tasks):
            task()
            if task.done():
                task.result()
        with self._tasks_lock:
            self._tasks = [each for each in self._tasks if not _ended(each[0])]


def _ended(task: Any) -> bool:
    return bool(task.done() or task.cancelled())
