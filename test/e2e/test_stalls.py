"""Processes that stand still in the midst of a move, and go on: nothing moves as before."""

import signal
import time
from dataclasses import replace

from driver_link import RATE, FakeTransport
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import free_port
from std_srvs.srv import SetBool

from fss_arm_driver.link_node import LinkNode
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import LinkCommand, SimTruth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import COMMAND, SENSOR

LIVES = 1.0  # a command [s]


def parameters(**values):
    return [Parameter(name, value=value) for name, value in values.items()]


def armed(spin, nodes, service):
    """Arm, again if a busy machine made a link wait for too long."""
    answers = []

    def asked():
        if not answers or (answers[-1].done() and not answers[-1].result().success):
            answers.append(service.call_async(SetBool.Request(data=True)))
        return answers[-1].done() and answers[-1].result().success

    spin(nodes, service.service_is_ready, 30.0)
    spin(nodes, asked, 30.0)


def test_an_arm_node_that_stood_still_moves_nothing_any_more(spin, start, tmp_path):
    arm, user = paper_arm(), Node("user")
    save(replace(arm, links=arm.links[:2]), tmp_path / "arm.yaml")
    file = str(tmp_path / "arm.yaml")
    transports = [FakeTransport(i) for i in (1, 2)]
    links = [
        LinkNode(i, transport=t, parameter_overrides=parameters(rate=RATE, timeout=2.5, arm=file))
        for i, t in enumerate(transports, 1)
    ]
    program = start("fss_arm_driver.arm_node", "--ros-args", "-p", f"arm:={file}")
    nodes, mover = [*links, user], ActionClient(user, MoveArm, "arm/move")
    armed(spin, nodes, user.create_client(SetBool, "arm/enable"))
    asked = mover.send_goal_async(MoveArm.Goal(q=[1.0, 1.0], duration=60.0))
    spin(nodes, lambda: asked.done() and all(t.link.speed for t in transports))
    ended = asked.result().get_result_async()

    program.process.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    spin(nodes, lambda: time.monotonic() > stopped + 2.0 * LIVES)
    assert not any(t.link.speed for t in transports)
    held = [t.link.position for t in transports]
    program.process.send_signal(signal.SIGCONT)
    spin(nodes, ended.done)
    assert ended.result().result.message.startswith("this node paused for ")
    resumed = time.monotonic()
    spin(nodes, lambda: time.monotonic() > resumed + 1.0)
    assert [t.link.position for t in transports] == held
    mover.destroy()


def test_a_test_bed_that_stood_still_lets_commands_expire_as_time_went_on(spin, start):
    port = free_port()
    bed = start("fss_sim.testbed_node", "--ros-args", "-p", f"ports:=[{port}, 0, 0, 0]")
    link = LinkNode(1, f"udp://127.0.0.1:{port}?bind=0")
    user, seen = Node("user"), []
    user.create_subscription(
        SimTruth, "sim/truth", lambda m: seen.append((stamp_ns(m.header.stamp), m.qd[3])), SENSOR
    )
    command = user.create_publisher(LinkCommand, "link_1/command", COMMAND)

    def turn():
        message = LinkCommand(mode=LinkCommand.VELOCITY, set_point=0.1, time_to_live=LIVES)
        message.header.stamp = user.get_clock().now().to_msg()
        command.publish(message)

    nodes = link, user
    spin(nodes, lambda: seen and not link.session.lost, 30.0)
    armed(spin, nodes, user.create_client(SetBool, "link_1/arm"))
    user.create_timer(0.1, turn)
    spin(nodes, lambda: seen[-1][1] > 0.08)

    bed.process.send_signal(signal.SIGSTOP)
    stopped = time.time_ns()
    spin(nodes, lambda: time.time_ns() > stopped + 3 * SECOND)
    bed.process.send_signal(signal.SIGCONT)
    spin(nodes, lambda: seen[-1][0] > stopped + 4 * SECOND)
    turned = {stamp - stopped for stamp, rate in seen if abs(rate) > 1e-3}
    assert 0.5 * LIVES * SECOND < max(turned) < (LIVES + 0.5) * SECOND
    assert not link.session.armed
