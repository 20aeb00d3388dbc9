"""The executor that nodes spin in: rclpy's own, but not overrun by many messages.

At each turn rclpy looks at all that a node has, which takes some tenths of a millisecond, and then
hands over one message of each subscription. Here it hands over all that have come; and while time
is simulated, where /clock alone calls for up to thousands of turns a second, turns keep a distance.
"""

import time
from collections.abc import Callable, Coroutine
from itertools import chain
from typing import Any

from rclpy.executors import SingleThreadedExecutor

from fss_arm_ros.ear import OutsideExecutors

BATCH = 64  # messages of one subscription in a turn, so that others have theirs
QUEUE = 10_000  # before a request, which may be about all that has come by then
PAUSE = 0.002  # from one turn to the next at least, in simulated time [s]

Step = Callable[[], Coroutine[Any, Any, None]]


class BatchExecutor(SingleThreadedExecutor):
    """Hands over the messages of a subscription that have come, not one a turn.

    A request is answered after the messages that came before it.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._turned = 0.0

    def _wait_for_ready_callbacks(self, *args: Any, **options: Any) -> Any:
        rest = self._turned + PAUSE - time.monotonic()
        if rest > 0.0 and any(node.get_clock().ros_time_is_active for node in self.get_nodes()):
            time.sleep(rest)
        self._turned = time.monotonic()
        yield from super()._wait_for_ready_callbacks(*args, **options)

    def _take_subscription(self, subscription: Any) -> Step:
        take = super()._take_subscription

        async def hand_over() -> None:
            await _all(BATCH, take, subscription)

        return hand_over

    def _take_service(self, service: Any) -> Step:
        take, take_message = super()._take_service, super()._take_subscription

        async def answer() -> None:
            for subscription in chain(*(node.subscriptions for node in self.get_nodes())):
                if not isinstance(subscription.callback_group, OutsideExecutors):
                    await _all(QUEUE, take_message, subscription)
            await _all(1, take, service)

        return answer


async def _all(most: int, take: Callable[[Any], Step | None], of: Any) -> None:
    """Hand over what has come of one entity, but not more than so much."""
    for _ in range(most):
        step = take(of)
        if step is None:
            return
        await step()
