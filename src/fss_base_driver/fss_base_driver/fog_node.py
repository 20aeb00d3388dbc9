"""Node `fog`: publishes a fibre-optic gyro on a serial port of this computer as fog/imu."""

import os
import sys
import time
from contextlib import suppress
from dataclasses import replace
from threading import Event, Lock, Thread
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import Imu

from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare, declare_live
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.rclpy_compat import RCLError
from fss_base_driver import messages
from fss_base_driver.dsp3000 import Lines
from fss_base_driver.programs import fog as main
from fss_base_driver.settings import FogCorrection, FogSettings, live_fog_kinds
from fss_link.host_clock import HostClock
from fss_link.transport import Line, open_port, readable

RETRY_INTERVAL = 0.5  # pause between attempts to open the port [s]
WAKE_INTERVAL = 0.2  # interval at which the thread checks for the shutdown [s]
HINT = "is it a DSP-3000 in its mode `rate`, and at this baud rate?"


class FogNode(Node):
    """Publish the turn rate measured by a KVH DSP-3000, instead of the board's gyro.

    Args:
        clock: the computer's clock, except in tests.
    """

    def __init__(self, clock: HostClock | None = None, **options: Any) -> None:
        super().__init__("fog", **options)
        self.settings = settings = declare(self, FogSettings, live=True)
        self.clock = clock or HostClock()
        self.correction, self.lines = FogCorrection(), Lines()
        self.imu = self.create_publisher(Imu, "fog/imu", SENSOR)
        self.lock, self.closing = Lock(), Event()
        self.problem, self.measured = "nothing received yet", 0
        self.before, self.last_time = self.lines.counts, time.monotonic()
        declare_live(self, live_fog_kinds(), self.on_live)
        self.port: Line | None = None
        try:
            self.port = open_port(settings.device, settings.baud)
        except OSError as error:
            why = error.strerror or error
            raise ValueError(f"device {settings.device!r} cannot be opened: {why}") from None
        self.diagnostics = Diagnostics(self, self.health, settings.device)
        self.get_logger().info(f"ready for rates from {settings.device}")
        self.thread = Thread(target=self.read_port, daemon=True)
        self.thread.start()

    def on_live(self, _: str, field: str, value: float) -> None:
        """Update a parameter that was set."""
        self.correction = replace(self.correction, **{field: value})

    def read_port(self) -> None:
        """Read the port until closed; open it again if it is lost."""
        while not self.closing.is_set():
            try:
                if self.port is None:
                    self.port = open_port(self.settings.device, self.settings.baud)
                    self.lines.reset()
                if readable([self.port], WAKE_INTERVAL):
                    self.process_bytes(os.read(self.port.fileno(), 4096), self.clock.now())
            except RCLError:
                return  # ROS was shut down
            except (OSError, ValueError) as error:
                self.close_port()
                self.problem = f"cannot use the port: {getattr(error, 'strerror', None) or error}"
                self.closing.wait(RETRY_INTERVAL)

    def process_bytes(self, data: bytes, arrival: int) -> None:
        """Publish the received rates; the last one has just arrived."""
        if not data:
            raise ConnectionResetError("the device is gone")
        with self.lock:
            rates = self.lines.feed(data)
        for late, rate in zip(range(len(rates) - 1, -1, -1), rates, strict=True):
            self.publish(arrival - round(SECOND * (self.settings.latency + 0.01 * late)), rate)

    def publish(self, measured: int, rate: float) -> None:
        """Publish a rate; stamps increase, unless the system time is set back."""
        self.measured, self.problem = max(measured, self.measured + 1), ""
        settings, gyro = self.settings, self.correction
        rate = gyro.scale * rate - gyro.bias
        stamp = self.measured + self.clock.offset
        self.imu.publish(messages.imu(stamp, rate, settings.gyro_noise, settings.base_frame))

    def close_port(self) -> None:
        """Close the port."""
        port, self.port = self.port, None
        if port:
            with suppress(OSError):
                port.close()

    def health(self) -> Health:
        """Return the health: whether rates arrive and are valid."""
        now, counts = time.monotonic(), self.lines.counts
        increases = [new - old for new, old in zip(counts, self.before, strict=True)]
        rate = increases[0] / max(now - self.last_time, 1e-9)
        self.before, self.last_time = counts, now
        values = {"rate [1/s]": rate, **counts._asdict()}
        if not rate:
            why = self.problem or "silent"
            if increases[1] or increases[2]:
                noise = f"the received bytes are no rates: {HINT}"
                why = "its rates are not valid" if increases[1] else noise
            return Health(ERROR, f"the gyro is lost: {why}", values)
        if increases[1] or increases[2]:
            return Health(WARN, "some lines are not valid", values)
        return Health(OK, "the gyro sends data", values)

    def close(self) -> None:
        """Stop the thread and close the port."""
        self.closing.set()
        self.thread.join()
        self.close_port()


if __name__ == "__main__":
    sys.exit(main())
