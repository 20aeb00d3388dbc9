"""Links of the arm's node as topics alone: they report, and do what they are told at once."""

from bisect import bisect_right

from rclpy.node import Node

from fss_arm_driver.protocol import State, hermite
from fss_arm_driver.scale import Scale
from fss_arm_model.description import paper_arm
from fss_arm_msgs.msg import LinkCommand, LinkPath, LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.qos import SENSOR

ARM = paper_arm()
RATE = 20.0  # of telemetry [1/s]


class FakeLinks(Node):
    """All links, ideal: a path is followed to the letter, and forgotten once its command expires.

    `off`: by how much each is off its path [rad]. `deaf`: those that hear nothing.
    """

    def __init__(self):
        super().__init__("fake_links")
        n = ARM.n
        self.scales = [Scale(link) for link in ARM.links]
        self.q, self.qd, self.off = [0.0] * n, [0.0] * n, [0.0] * n
        self.armed, self.referenced, self.silent = [True] * n, [True] * n, set()
        self.deaf, self.taken = set(), []  # commands: time, number, message
        self.paths, self.told, self.broken = [{} for _ in ARM.links], [None] * n, [False] * n
        self.telemetry = []
        for i in range(n):
            name = f"link_{i + 1}"
            self.telemetry.append(self.create_publisher(LinkTelemetry, f"{name}/telemetry", SENSOR))
            self.create_subscription(
                LinkCommand, f"{name}/command", lambda m, i=i: self.on_command(i, m), 10
            )
            self.create_subscription(
                LinkPath, f"{name}/path", lambda m, i=i: self.paths[i].update({m.path: m}), 10
            )
        self.create_timer(1.0 / RATE, self.report)

    def now(self):
        return self.get_clock().now().nanoseconds

    def on_command(self, i, message):
        if i + 1 in self.deaf:
            return
        self.taken.append((self.now(), i + 1, message))
        self.told[i] = message

    def last(self, number):
        return [m for _, i, m in self.taken if i == number][-1]

    def move(self, i, now):
        """Where a link is, and whether it follows a path."""
        told = self.told[i]
        if told and now > stamp_ns(told.header.stamp) + told.time_to_live * SECOND:
            self.told[i] = told = None
        self.qd[i] = 0.0
        if told is None or told.mode != LinkCommand.PATH or told.path not in self.paths[i]:
            if told and told.mode == LinkCommand.POSITION:
                self.q[i] = told.set_point
            return False
        path = self.paths[i][told.path]
        t = (now - stamp_ns(path.header.stamp)) / SECOND
        if t < 0.0:
            return False
        if t >= path.time[-1]:
            self.q[i] = path.position[-1] + self.off[i]
            return False
        k = bisect_right(path.time, t) - 1
        since, until = path.time[k : k + 2]
        (q0, q1), (v0, v1) = path.position[k : k + 2], path.velocity[k : k + 2]
        q, self.qd[i] = hermite(t - since, until - since, q0, v0, q1, v1)
        self.q[i] = q + self.off[i]
        return True

    def report(self):
        now = self.now()
        for i, (publisher, scale) in enumerate(zip(self.telemetry, self.scales, strict=True)):
            follows = self.move(i, now) and not self.broken[i]
            if i + 1 in self.silent:
                continue
            message = LinkTelemetry(link=i + 1, torque=400_000, armed=self.armed[i])
            message.header.stamp = to_time(now)
            message.position = round(self.q[i] / scale.radians_per_count)
            message.velocity = round(self.qd[i] / (0.1 * scale.radians_per_count))
            flags = State.REFERENCED * self.referenced[i] | State.FOLLOWING * follows
            message.flags = int(flags | State.BROKEN * self.broken[i])
            message.path = max(self.paths[i], default=0) << 16
            publisher.publish(message)
