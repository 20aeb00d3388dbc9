"""The whole graph with a simulated test bed that keeps the time, and who flies it."""

from contextlib import contextmanager
from time import monotonic

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import OWN
from std_srvs.srv import SetBool
from unique_identifier_msgs.msg import UUID

from fss_arm_msgs.action import GoToPose, HoldBase, MoveArm
from fss_arm_msgs.msg import MissionState, SimTruth
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor
from fss_rehearsal.processes import Nodes

ACTIONS = {"base/hold": HoldBase, "base/go_to": GoToPose, "arm/move": MoveArm}


def start(nodes, speed=0.0, links=4, testbed=None, **parameters):
    """Start the graph: the test bed's parameters, and those of others by node."""
    domain, clock = nodes.domain, {"use_sim_time": True}
    board, driver = domain.ports(2 * links + 2)[-2:]
    patient = {"timeout": 4.0, "watchdog": 4.0, **clock}  # of a busy computer
    nodes.start(
        "testbed",
        "fss_sim",
        "testbed",
        ports=domain.ports(links),
        board_port=board,
        keep_clock=True,
        speed=speed,
        truth_rate=50.0,
        **(testbed or {}),
    )
    nodes.start("links", "fss_arm_driver", "link", urls=domain.urls(links), **patient)
    nodes.start("arm", "fss_arm_driver", "arm", time_to_live=2.0, **clock)
    url = f"udp://127.0.0.1:{board}?bind={driver}"
    nodes.start("base", "fss_base_driver", "base", url=url, **clock, **parameters.get("base", {}))
    options = {"control": {"max_pause": 4.0}}
    for name in ("navigation", "control", "guidance"):
        given = options.get(name, {})
        nodes.start(name, "fss_gnc", name, **clock, **given, **parameters.get(name, {}))


class Flyer(Node):
    """Arms links and valves, sends goals, and keeps what really happened."""

    def __init__(self, nodes, say=print, namespace=""):
        simulated = [Parameter("use_sim_time", value=True)]
        super().__init__("flyer", namespace=namespace, parameter_overrides=simulated)
        self.nodes, self.say, self.truths, self.states = nodes, say, [], []
        self.base = None
        self.clients_to = {n: ActionClient(self, kind, n) for n, kind in ACTIONS.items()}
        self.armers = [self.create_client(SetBool, name) for name in ("arm/enable", "base/arm")]
        self.create_subscription(SimTruth, "sim/truth", self.truths.append, SENSOR)
        self.create_subscription(MissionState, "mission/state", self.states.append, LATCHED)
        self.moves = []  # ids of goals of arm/move; the last one is kept alive
        self.alive = self.create_publisher(UUID, "arm/move/alive", 10)
        real_time = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.5, self.keep_alive, clock=real_time)
        subscribe_sensor(self, Odometry, "base/state", self.on_base)
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def keep_alive(self):
        for move in self.moves[-1:]:
            self.alive.publish(move)

    def on_base(self, message):
        self.base = message

    @property
    def t(self):
        """The test bed's time [s]."""
        return 1e-9 * stamp_ns(self.truths[-1].header.stamp) if self.truths else 0.0

    def until(self, condition, timeout=180.0, why="it"):
        """Wait for a condition; within real time [s]."""
        deadline = monotonic() + timeout
        while not (found := condition()):
            if monotonic() > deadline:
                raise TimeoutError(f"{why}: not within {timeout} s")
            self.executor_.spin_once(timeout_sec=0.02)
        return found

    def after(self, future, timeout=180.0):
        self.until(future.done, timeout)
        return future.result()

    def pass_time(self, seconds, timeout=120.0):
        """Let so much of the test bed's time pass."""
        end = self.t + seconds
        self.until(lambda: self.t >= end, timeout)

    def begin(self):
        """Arm all, and wait until it is known where the base is."""
        for armer in self.armers:
            self.until(armer.service_is_ready, why=armer.srv_name)
            deadline = monotonic() + 120.0
            while not (answer := self.after(armer.call_async(SetBool.Request(data=True)))).success:
                if monotonic() > deadline:
                    raise TimeoutError(answer.message)
        self.until(lambda: self.base, why="base/state")
        for name, client in self.clients_to.items():
            self.until(client.server_is_ready, why=name)

    def send(self, name, **goal):
        moves = name == "arm/move"
        goal |= {"keep_alive": 10.0} if moves else {}  # of a busy computer
        handle = self.after(self.clients_to[name].send_goal_async(ACTIONS[name].Goal(**goal)))
        assert handle.accepted
        self.moves += [handle.goal_id] if moves else []
        return handle

    def end(self, handle, timeout=300.0):
        return self.after(handle.get_result_async(), timeout)

    def does(self, name, timeout=300.0, **goal):
        return self.end(self.send(name, **goal), timeout)

    def holding(self, timeout=120.0):
        """Hold where the base is; once it does. A graph that has just begun may refuse it."""
        deadline = monotonic() + timeout
        while monotonic() < deadline:
            handle = self.send("base/hold")
            ended = handle.get_result_async()
            self.until(lambda e=ended: e.done() or self.states[-1].phase == "hold")
            if not ended.done():
                return handle
        raise TimeoutError(ended.result().result.message)

    def stop_drifting(self):
        """Hold for a while, so that the base rests."""
        handle = self.holding()
        self.pass_time(5.0)
        self.after(handle.cancel_goal_async())
        self.end(handle)

    def off(self, pose, since=0.0):
        """Farthest from a pose since a time: [m], [deg]."""
        rows = np.array([t.q[:3] for t in self.truths if 1e-9 * stamp_ns(t.header.stamp) >= since])
        apart = rows - np.asarray(pose)
        return np.hypot(*apart[:, :2].T).max(), np.degrees(np.abs(apart[:, 2])).max()

    def close(self):
        for client in self.clients_to.values():
            client.destroy()
        self.executor_.shutdown()
        self.destroy_node()


@contextmanager
def flown(folder, speed):
    """A flyer of base and arm, whose valves and links are armed, at `speed` of the time."""
    rclpy.init(args=[])
    with Nodes(folder, print, OWN) as nodes:
        start(nodes, speed=speed, base={"timeout": 4.0, "watchdog": 4.0})
        flyer = Flyer(nodes)
        flyer.begin()
        yield flyer
        flyer.close()
    rclpy.try_shutdown()
