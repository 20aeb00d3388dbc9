"""The node `mocap`: poses of a motion-capture system or another receiver, as nodes read them."""

import sys
import time
from functools import partial
from threading import Lock
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import SENSOR, subscribe_sensor
from fss_base_driver.mocap import Pose, Receiver, RelayError, Subjects, message_type, named_poses
from fss_base_driver.mocap.subjects import Bounds
from fss_base_driver.programs import mocap as main
from fss_base_driver.settings import MocapSettings

STAMPS = {True: "stamped by the relayed header", False: "stamped by arrival"}


class MocapNode(Node):
    """Publishes poses of motion capture in metres; none that is occluded or has jumped."""

    def __init__(self, **options: Any) -> None:
        super().__init__("mocap", **options)
        self.settings = s = declare(self, MocapSettings)
        self.subjects = Subjects(Bounds(s.max_speed, s.max_turn, s.settle_time))
        self.topics, self.poses = s.topics(), dict[str, Publisher]()
        self.waiting = [relay.rpartition("=")[::2] for relay in s.relays]
        self.lock = Lock()  # frames come in a thread of their own
        self.frames, self.heard, self.by_header = 0, time.monotonic_ns(), False
        self.trouble = ""  # until a frame comes
        self.create_service(Trigger, "mocap/accept", self.on_accept)
        self.create_timer(0.5, self.look_for_relays, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health, s.host)
        host = [f"hostname={s.host}"] if s.host else []
        self.receiver = (
            Receiver(s.system, [*host, *s.options], self.on_frame, self.on_end)
            if s.system
            else None
        )

    def on_frame(self, arrival: int, poses: dict[str, Pose]) -> None:
        """Publish a frame of the system."""
        self.take(arrival - round(self.settings.latency * SECOND), poses)

    def on_message(self, subject: str, message: Any) -> None:
        """Publish what another receiver says."""
        stamp = stamp_ns(message.header.stamp) if hasattr(message, "header") else 0
        self.by_header = bool(stamp)
        arrival = time.time_ns() - round(self.settings.latency * SECOND)
        self.take(stamp or arrival, dict(named_poses(message, subject, self.settings.relay_scale)))

    def take(self, stamp: int, poses: dict[str, Pose]) -> None:
        """Publish those of a frame's poses that are believed."""
        wanted = {n: p for n, p in poses.items() if not self.topics or n in self.topics}
        with self.lock:
            self.frames, self.heard, self.trouble = self.frames + 1, time.monotonic_ns(), ""
            for name, pose in self.subjects.take(stamp, wanted).items():
                self.publish(name, stamp, pose)

    def publish(self, name: str, stamp: int, pose: Pose) -> None:
        """Publish a pose of a subject."""
        if name not in self.poses:
            place = self.topics.get(name, f"{name}/{name}")
            topic = f"{self.settings.prefix}/{place}"
            self.poses[name] = self.create_publisher(PoseStamped, topic, SENSOR)
        message = PoseStamped()
        message.header.stamp = to_time(stamp)
        message.header.frame_id = self.settings.frame_id
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = pose
        self.poses[name].publish(message)

    def look_for_relays(self) -> None:
        """Subscribe to topics to relay as soon as their types are known."""
        types = dict(self.get_topic_names_and_types()) if self.waiting else {}
        for subject, topic in list(self.waiting):
            if kinds := types.get(self.resolve_topic_name(topic)):
                self.waiting.remove((subject, topic))
                try:
                    take = partial(self.on_message, subject or topic.rpartition("/")[2])
                    subscribe_sensor(self, message_type(kinds[0]), topic, take)
                except RelayError as error:
                    self.on_end(f"{topic}: {error}")

    def on_end(self, why: str) -> None:
        """Log, once, why no frames come: the receiving process has ended, or hears nothing."""
        if why != self.trouble and self.context.ok():
            self.get_logger().error(why)
        self.trouble = why

    def on_accept(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A person says that each subject is what it is called."""
        with self.lock:
            doubts = self.subjects.doubts(time.time_ns())
            self.subjects.accept()
        response.success = True
        response.message = f"believed again: {', '.join(doubts) or 'none was in doubt'}"
        return response

    def health(self) -> Health:
        """For diagnostics."""
        now, timeout = time.time_ns(), self.settings.timeout
        with self.lock:
            silence = (time.monotonic_ns() - self.heard) / SECOND
            doubts, silent = self.subjects.doubts(now), self.subjects.silent(now, timeout)
            counts = {name: dict(s.counts) for name, s in self.subjects.subjects.items()}
        values = {"frames": self.frames, "time": STAMPS[self.by_header], **counts}
        if silence > timeout and not self.trouble:
            places = ", ".join(self.settings.relays)
            origin = f"{self.settings.system} {self.settings.host}".strip() or places
            self.on_end(f"no frame {'any more' if self.frames else 'yet'} from {origin}")
        if self.trouble:
            return Health(ERROR, f"{self.trouble} ({silence:.1f} s)", values)
        words = [f"{name} {why}" for name, why in doubts.items()]
        words += [f"{name} not seen anew for {age:.1f} s" for name, age in silent.items()]
        return Health(WARN if words else OK, "; ".join(words) or "receiving", values)

    def close(self) -> None:
        """End the receiving process."""
        if self.receiver:
            self.receiver.close()


if __name__ == "__main__":
    sys.exit(main())
