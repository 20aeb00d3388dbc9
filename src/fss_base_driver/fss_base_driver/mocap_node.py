"""Node `mocap`: publishes poses of a motion-capture system or of another receiver."""

import sys
import time
from functools import partial
from threading import Lock
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from fss_arm_model.settings import SettingError
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.libraries import require
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import SENSOR, subscribe_sensor
from fss_arm_ros.rclpy_compat import RCLError
from fss_base_driver.messages import pose_stamped
from fss_base_driver.mocap import Bounds, Pose, Receiver, Reception, Relay, RelayError, Subjects
from fss_base_driver.mocap.reception import describe_problems
from fss_base_driver.mocap.relays import describe_waiting, message_type, named_poses
from fss_base_driver.programs import mocap as main
from fss_base_driver.relay_topics import read_relay
from fss_base_driver.settings import MocapSettings

STAMPS = {True: "stamped by the relayed header", False: "stamped by arrival"}


class MocapNode(Node):
    """Publish poses of motion capture in metres, except occluded ones and jumps."""

    def __init__(self, **options: Any) -> None:
        super().__init__("mocap", **options)
        self.settings = s = declare(self, MocapSettings)
        self.subjects = Subjects(Bounds(s.max_speed, s.max_turn, s.settle_time))
        self.places = s.places()
        self.poses: dict[str, Publisher | None] = {}  # None: the name is invalid in a topic
        for name in self.places:
            self.poses[name] = self.new_publisher(name)
        self.relays = [read_relay(self, relay) for relay in s.relays]
        self.lock = Lock()  # frames arrive in a separate thread
        self.reception = Reception(s.source(), time.monotonic_ns())
        self.by_header, self.last_log = False, ""  # the last message had a stamp; last log line
        self.create_service(Trigger, "mocap/accept", self.on_accept)
        self.create_timer(0.5, self.look_for_relays, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = Diagnostics(self, self.health, s.host)
        self.receiver: Receiver | None = None
        if s.system:
            require("motioncapture")  # the receiving process imports it
            host = [f"hostname={s.host}"] if s.host else []
            self.receiver = Receiver(s.system, [*host, *s.options], self.on_frame, self.on_end)
        self.get_logger().info(f"waiting for {s.source()}")

    def on_frame(self, arrival: int, poses: dict[str, Pose]) -> None:
        """Publish a frame of the system."""
        self.count_frame(poses)
        self.publish_accepted(arrival - round(self.settings.latency * SECOND), poses)

    def on_message(self, relay: Relay, message: Any) -> None:
        """Publish the poses of a relayed message."""
        stamp = stamp_ns(message.header.stamp) if hasattr(message, "header") else 0
        self.by_header = bool(stamp)
        arrival = time.time_ns() - round(self.settings.latency * SECOND)
        named = named_poses(message, relay.subject, self.settings.relay_scale)
        poses = {name or relay.last_name: pose for name, pose in named}
        if not self.settings.system:  # otherwise relays would hide that the system is silent
            self.count_frame(poses)
        self.publish_accepted(stamp or arrival, poses)

    def count_frame(self, poses: dict[str, Pose]) -> None:
        """Count a frame of the system, or of a relay if there is no system."""
        with self.lock:
            self.reception.add(len(poses), time.monotonic_ns())
            self.last_log = "" if poses else self.last_log

    def publish_accepted(self, stamp: int, poses: dict[str, Pose]) -> None:
        """Publish the accepted poses of a frame."""
        wanted = {n: p for n, p in poses.items() if not self.places or n in self.places}
        with self.lock:
            accepted = self.subjects.filter_frame(stamp, wanted, time.monotonic_ns())
            for name, pose in accepted.items():
                self.publish(name, stamp, pose)

    def publish(self, name: str, stamp: int, pose: Pose) -> None:
        """Publish a pose of a subject, if its name is valid in a topic."""
        if name not in self.poses:
            try:
                self.poses[name] = self.new_publisher(name)
            except SettingError:
                self.poses[name] = None
        if publisher := self.poses[name]:
            publisher.publish(pose_stamped(stamp, self.settings.frame_id, pose))

    def new_publisher(self, name: str) -> Publisher:
        """Return a publisher of a subject's poses.

        Raises:
            SettingError: the topic's name is invalid.
        """
        topic = f"{self.settings.prefix}/{self.places.get(name, f'{name}/{name}')}"
        try:
            return self.create_publisher(PoseStamped, topic, SENSOR)
        except (NameValidationException, RCLError) as error:
            raise SettingError(f"subjects: {topic!r} is no valid topic name: {error}") from None

    def look_for_relays(self) -> None:
        """Subscribe to relayed topics once they have a type that can be read."""
        waiting = [relay for relay in self.relays if relay.obstacle]
        types = dict(self.get_topic_names_and_types()) if waiting else {}
        for relay in waiting:
            try:
                if kinds := types.get(relay.topic):
                    callback = partial(self.on_message, relay)
                    kind = message_type(kinds, relay.subject)
                    subscribe_sensor(self, kind, relay.topic, callback)
                    relay.obstacle = ""
            except RelayError as error:
                if relay.obstacle != (obstacle := str(error)):
                    self.get_logger().error(f"{relay.topic}: {obstacle}")
                relay.obstacle = obstacle

    def on_end(self, why: str) -> None:
        """Store and log why the receiving process has ended."""
        self.reception.failure = why
        self.log_once(why)

    def log_once(self, why: str) -> None:
        """Log once why no poses arrive."""
        if why != self.last_log and self.context.ok():
            self.get_logger().error(why)
        self.last_log = why

    def on_accept(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Accept all subjects, because the operator confirms their names."""
        with self.lock:
            rejected = self.subjects.rejection_reasons(time.monotonic_ns())
            self.subjects.accept_all()
        response.success = True
        response.message = f"accepted again: {', '.join(rejected) or 'none was rejected'}"
        return response

    def health(self) -> Health:
        """Return the health for diagnostics."""
        now, timeout, reception = time.monotonic_ns(), self.settings.timeout, self.reception
        waiting = describe_waiting(self.relays)
        with self.lock:
            invalid = [name for name, publisher in self.poses.items() if publisher is None]
            silence = reception.silence(now)
            words = describe_problems(self.subjects, self.places, invalid, now, timeout) + waiting
            counts = {name: dict(s.counts) for name, s in self.subjects.subjects.items()}
        values = {"frames": reception.frames, "time": STAMPS[self.by_header], **counts}
        why = reception.failure
        if not why and silence > timeout:
            connected = self.receiver.connected if self.receiver else None
            why = reception.loss_reason(connected, waiting)
        if why:
            self.log_once(why)
            return Health(ERROR, f"{why} ({silence:.1f} s)", values)
        return Health(WARN if words else OK, "; ".join(words) or "receiving", values)

    def close(self) -> None:
        """Stop the receiving process."""
        if self.receiver:
            self.receiver.close()


if __name__ == "__main__":
    sys.exit(main())
