"""Node `view`: displays the test bed, live or replayed, on a page and in rerun."""

import os
import socket
import sys
import time
from collections import Counter
from ipaddress import ip_address
from typing import Any

import rerun as rr
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import sensor
from fss_arm_ros.timing import MISSED
from fss_arm_ros.validation import subscribe

from . import scene
from .live import to_json
from .programs import view as main
from .settings import ViewSettings
from .sink import (
    FILE,
    WEB,
    Sink,
    VehicleSink,
    Viewer,
    disable_analytics,
    host,
    listen,
    new_file,
    open_stream,
)
from .vehicle_topics import VehicleTopics

PERIOD = 0.1  # at which topics are polled and the page is updated [s]
NICE = 10  # priority of the node and of the gate: low
MAX_PERIOD = 0.2  # between updates; at a longer one, nothing is drawn in rerun [s]
LEVELS = {OK: "INFO", WARN: "WARN", ERROR: "ERROR"}


class ViewNode(Node):
    """Node that displays a vehicle, and has the viewer that further vehicles share."""

    def __init__(self, **options: Any) -> None:
        super().__init__("view", **options)
        s = self.settings = declare(self, ViewSettings)
        ports = listen(s.mode, s.bind, s.port, s.web_port)  # before anything else starts
        self.config_folder = disable_analytics()
        self.viewer = Viewer(s.mode, s.bind, ports, s.memory, s.names) if ports else None
        self.sink, self.legend = Sink(self.open_recording(), s.rate, s.queue), scene.Legend()
        self.updated = time.monotonic()  # time of the last update [s]
        self.reported: Counter[str] = Counter()  # the sink's counts when last reported
        self.logged_levels: dict[str, bytes] = {}
        self.own = VehicleTopics(self, s, self.sink, self.legend, self.restart)
        self.others: list[VehicleTopics] = []
        best_effort = sensor(best_effort=True)
        subscribe(self, DiagnosticArray, "/diagnostics", self.on_diagnostics, best_effort)
        if s.mode == WEB:
            self.log_address()
        self.diagnostics = Diagnostics(self, self.health)
        self.create_timer(PERIOD, self.update, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add_vehicle(self, namespace: str) -> Node:
        """Return a node that displays the vehicle of a namespace, too."""
        node = Node("view", namespace=namespace)
        name = node.get_namespace().strip("/")
        sink = VehicleSink(self.sink, name)
        settings = declare(node, ViewSettings)
        self.others.append(VehicleTopics(node, settings, sink, self.legend, self.restart, name))
        return node

    @property
    def vehicles(self) -> list[VehicleTopics]:
        """Vehicles whose state the strip shows: the added ones, or else the only one."""
        return self.others or [self.own]

    def open_recording(self) -> rr.RecordingStream:
        """Open a recording in the viewer or in a new file."""
        s = self.settings
        target = self.viewer.url if self.viewer else s.url
        if s.mode == FILE:
            target = new_file(s.file)
            self.get_logger().info(f"writing {target}")
        return open_stream(s.mode, target, scene.blueprint())

    def restart(self) -> None:
        """Start a new recording, and reset all vehicles."""
        self.sink.stream = self.open_recording()
        self.legend.reset()
        for vehicle in (self.own, *self.others):
            vehicle.reset()

    def update(self) -> None:
        """Handle the messages that have arrived, and send the state to the page.

        If this is late because the computer is busy, rerun waits: the page must not be late.
        """
        late = time.monotonic() - self.updated > MAX_PERIOD
        self.sink.is_paused = late and self.settings.mode == WEB
        self.updated = time.monotonic()
        for topics in (self.own, *self.others):
            topics.poll()
        if self.viewer and self.settings.mode == WEB:
            now, newest = time.monotonic(), max(self.vehicles, key=lambda one: one.received)
            states = [vehicle.state(now) for vehicle in self.vehicles]
            self.viewer.send(to_json(time.time(), newest.t, now - newest.received, states))

    def log_address(self) -> None:
        """Log the address of the page, with a warning if other computers can reach it."""
        s, log = self.settings, self.get_logger()
        name = host(s.bind, socket.gethostname())
        log.info(f"open http://{name}:{s.web_port}")
        if not ip_address(s.bind).is_loopback:
            log.warning(
                f"{name}:{s.port} has no authentication: all who reach it can change rerun's view"
            )

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Show each node's error in the strip, and log each node's state when it changes."""
        for status in message.status:
            self.update_strip(status)
            if self.logged_levels.get(status.name) != status.level:
                self.logged_levels[status.name] = status.level
                level = LEVELS.get(status.level, "WARN")
                self.own.log_event(f"{status.name}: {status.message}", level)

    def update_strip(self, status: DiagnosticStatus) -> None:
        """Show a node's error, and its missed deadlines, in its vehicle's strip.

        Vehicles share the nodes without a namespace, such as `mocap`.
        """
        error = status.message if status.level == ERROR else ""
        values = (pair.value for pair in status.values if pair.key == MISSED)
        missed = next((int(value) for value in values if value.isdecimal()), 0)
        namespace = f"/{status.name.strip('/')}".rpartition("/")[0].strip("/")
        for vehicle in self.vehicles:
            if not namespace or vehicle.name in ("", namespace):
                vehicle.strip.add_report(status.name, error, missed, time.monotonic())

    def health(self) -> Health:
        """Return the node's health for diagnostics."""
        now, before = Counter(self.sink.counts), self.reported
        self.reported = now
        if self.viewer and not self.viewer.is_running():
            return Health(ERROR, "the viewer has stopped; restart this node", now)
        if now["dropped"] > before["dropped"] and now["shown"] == before["shown"]:
            return Health(WARN, "the viewer accepts no drawings", now)
        return Health(OK, f"running in mode {self.settings.mode}", now)

    def close(self) -> None:
        """Write the waiting drawings and stop the viewer."""
        self.sink.close()
        if self.viewer:
            self.viewer.close()
        self.config_folder.cleanup()


def make_nodes() -> list[Node]:
    """Display joints, base, end effector, base reaction, verdicts and faults.

    In mode web, open the address that the node logs in a browser: the page shows the present, and
    links to rerun, which shows history and plots. The node only watches: it subscribes best effort,
    and never waits for the page or for rerun.
    """
    # Drivers do not wait for this node and the gate; rerun runs only when the processor is idle.
    # Idle priority for all would stop the page on a busy computer.
    os.nice(NICE)
    owner = ViewNode()
    return [owner, *map(owner.add_vehicle, owner.settings.vehicles)]


if __name__ == "__main__":
    sys.exit(main())
