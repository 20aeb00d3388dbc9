"""Node `fog`: publishes a fibre-optic gyro on a serial port of this computer as fog/imu."""

import os
import sys
import termios
import time
from contextlib import suppress
from dataclasses import replace
from threading import Event, Thread
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import Imu

from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare, declare_live
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.rclpy_compat import RCLError
from fss_base_driver import messages
from fss_base_driver.dsp3000 import RATE, Counts, Lines
from fss_base_driver.programs import fog as main
from fss_base_driver.settings import FogCorrection, FogSettings, live_fog_kinds
from fss_link.host_clock import HostClock
from fss_link.transport import Line, open_port, readable

RETRY_INTERVAL = 0.5  # pause between attempts to open the port [s]
WAKE_INTERVAL = 0.2  # interval at which the thread checks for the shutdown [s]
MAX_PAUSE = 2.0  # without reading; after a longer one, the port's buffer may have overflowed [s]
TIMEOUT = 1.5  # without lines of a kind after which they no longer count, above 1 s [s]
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
        self.closing = Event()
        self.error: RCLError | None = None  # error that has ended the thread
        self.problem, self.measured, self.pauses = "nothing received yet", 0, 0
        self.last_counts, self.last_time = self.lines.counts, time.monotonic()
        self.received: dict[str, float] = {}  # time of the last line of each kind in Counts [s]
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
        last_time = self.clock.now()
        while not self.closing.is_set():
            try:
                if self.port is None:
                    self.port = open_port(self.settings.device, self.settings.baud)
                    self.lines.reset()
                    last_time = self.clock.now()
                    self.problem = "nothing received since the port was reopened"
                is_readable = readable([self.port], WAKE_INTERVAL)
                now = self.clock.now()
                if now - last_time > MAX_PAUSE * SECOND:
                    self.flush_port()
                elif is_readable:
                    self.process_bytes(os.read(self.port.fileno(), 4096), now)
                last_time = now
            except RCLError as error:
                if self.context.ok():
                    self.error = error
                return  # else ROS was shut down
            except (OSError, ValueError, termios.error) as error:
                self.close_port()
                self.problem = f"cannot use the port: {getattr(error, 'strerror', None) or error}"
                self.closing.wait(RETRY_INTERVAL)

    def flush_port(self) -> None:
        """Drop what was received during a pause of this process: its time is not known."""
        assert self.port
        termios.tcflush(self.port.fileno(), termios.TCIFLUSH)
        self.lines.reset()
        self.pauses += 1

    def process_bytes(self, data: bytes, arrival: int) -> None:
        """Publish the received rates; the last line has just arrived."""
        if not data:
            raise ConnectionResetError("the device is gone")
        before, rates = self.lines.counts, self.lines.feed(data)
        now, counts = time.monotonic(), self.lines.counts
        self.received |= {
            kind: now
            for kind, old, new in zip(Counts._fields, before, counts, strict=True)
            if new > old
        }
        for late, rate in zip(range(len(rates) - 1, -1, -1), rates, strict=True):
            if rate is not None:
                delay = self.settings.latency + late / RATE
                self.publish(arrival - round(SECOND * delay), rate)

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
        if self.error:
            raise self.error
        now, counts = time.monotonic(), self.lines.counts
        rate = (counts.rates - self.last_counts.rates) / max(now - self.last_time, 1e-9)
        self.last_counts, self.last_time = counts, now
        values = {"rate [1/s]": rate, **counts._asdict(), "pauses": self.pauses}
        recent = {kind for kind, then in list(self.received.items()) if now - then < TIMEOUT}
        if "rates" not in recent:
            why = self.problem or "silent"
            if "faults" in recent:
                why = "its rates are not valid"
            elif "noise" in recent:
                why = f"the received bytes are no rates: {HINT}"
            return Health(ERROR, f"the gyro is lost: {why}", values)
        if recent != {"rates"}:
            return Health(WARN, "some lines are not valid", values)
        return Health(OK, "the gyro sends data", values)

    def close(self) -> None:
        """Stop the thread and close the port."""
        self.closing.set()
        self.thread.join()
        self.close_port()


if __name__ == "__main__":
    sys.exit(main())
