"""A timer that fires once, started and canceled by threads."""

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fss_arm_ros.timers import OneShotTimer

STEADY = Clock(clock_type=ClockType.STEADY_TIME)


def test_it_fires_once_after_each_start(spin):
    node, fired = Node("one_shot"), []
    timer = OneShotTimer(node, lambda: fired.append(1), STEADY)
    for count in (1, 2):
        timer.start(1_000_000)
        spin(node, lambda count=count: len(fired) >= count)
    turns = []
    node.create_timer(0.01, lambda: turns.append(1), clock=STEADY)
    timer.start(1_000_000)
    timer.cancel()
    spin(node, lambda: len(turns) >= 5)
    assert len(fired) == 2


class Cancelling(MutuallyExclusiveCallbackGroup):
    """Group that cancels a timer between the check that it is ready and its call."""

    def __init__(self, cancel):
        super().__init__()
        self.cancel, self.canceled = cancel, 0

    def beginning_execution(self, entity):
        self.cancel()
        self.canceled += 1
        return super().beginning_execution(entity)


def canceled_when_ready(node, timer):
    """Return the group of a node's only timer, which cancels it when it is about to be called."""
    (entity,) = node.timers
    entity.callback_group = group = Cancelling(timer.cancel)
    group.add_entity(entity)
    return group


def test_it_may_be_canceled_while_the_executor_is_about_to_call_it(spin):
    """A plain timer ends the node with "failed to call timer: timer is canceled"."""
    node, fired = Node("one_shot", start_parameter_services=False), []
    timer = OneShotTimer(node, lambda: fired.append(1), STEADY)
    group = canceled_when_ready(node, timer)
    timer.start(0)
    spin(node, lambda: group.canceled)
    assert not fired
