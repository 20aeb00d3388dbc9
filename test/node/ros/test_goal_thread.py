"""Goals are received in a thread of their own, and executed in the node's executor."""

from threading import get_ident

import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient, ActionServer, GoalResponse
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from fss_arm_msgs.action import MoveArm
from fss_arm_ros.goal_thread import GoalThread
from fss_arm_ros.subscriptions import Topic


class Mover(Node):
    """Offers an action; remembers the thread of each callback."""

    def __init__(self):
        super().__init__("mover")
        self.threads = {}
        topic = Topic(Float64, "number", QoSProfile(depth=10), self.on_number)
        self.thread = GoalThread(self, [topic])
        self.thread.serve(
            ActionServer(
                self,
                MoveArm,
                "move",
                self.on_execute,
                goal_callback=self.on_goal,
                callback_group=self.thread.group,
            )
        )
        self.close = self.thread.close

    def on_number(self, message):
        self.threads["topic"] = get_ident()

    def on_goal(self, goal):
        self.threads["goal"] = get_ident()
        if goal.duration < 0.0:
            raise ValueError("negative")
        return GoalResponse.ACCEPT

    def on_execute(self, handle):
        self.threads["execute"] = get_ident()
        handle.succeed()
        return MoveArm.Result(message="done")


@pytest.fixture
def bench(spin):
    mover, user = Mover(), Node("user")
    client = ActionClient(user, MoveArm, "move")
    spin([mover, user], client.server_is_ready)
    yield mover, user, client
    client.destroy()


def test_goals_are_received_in_the_thread_and_executed_in_the_executor(bench, spin):
    mover, user, client = bench
    publisher = user.create_publisher(Float64, "number", 10)
    spin([mover, user], publisher.get_subscription_count)
    publisher.publish(Float64())
    sent = client.send_goal_async(MoveArm.Goal())
    spin([mover, user], lambda: sent.done() and "topic" in mover.threads)
    ended = sent.result().get_result_async()
    spin([mover, user], ended.done)
    assert ended.result().status == GoalStatus.STATUS_SUCCEEDED
    assert ended.result().result.message == "done"
    own = mover.thread.ident
    assert mover.threads == {"goal": own, "topic": own, "execute": get_ident()}


def test_an_error_in_the_thread_ends_the_node(bench, spin):
    mover, user, client = bench
    client.send_goal_async(MoveArm.Goal(duration=-1.0))
    with pytest.raises(ValueError, match="negative"):
        spin([mover, user], lambda: False)


def test_the_action_belongs_to_the_node(bench):
    _, user, _ = bench
    services = dict(user.get_service_names_and_types_by_node("mover", "/"))
    assert "/move/_action/send_goal" in services
