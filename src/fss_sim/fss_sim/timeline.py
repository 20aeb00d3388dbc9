"""Time of the simulated test bed: frames that are due, pauses, single steps and stamps."""

import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol

from fss_arm_model.units import SECOND
from fss_sim.pace import (
    DRIVER_TIMEOUT,
    MAX_LEAD,
    NODE_LEAD,
    NODE_TIMEOUT,
    ClockPace,
    Followers,
    FullSpeedPace,
    Pace,
)
from fss_sim.sensors import RATE
from fss_sim.testbed import FRAME

# Largest number of late frames per tick, so that the node remains responsive.
MAX_FRAMES_PER_TICK = RATE
MAX_CATCH_UP = 0.3  # longest stall of a busy computer that is made up for, in real time [s]
MAX_DEAFNESS = SECOND  # longest time without reading datagrams because frames are late [ns]
FRAMES_PER_CLOCK = 5  # number of frames for which the clock is published once
PAUSED_CLOCK_PERIOD = 0.5  # period of publishing the clock while paused [s]
MAX_FRAMES = 60 * RATE  # largest number of frames of one step, so that the node responds soon
ROS_TIME = (
    "the test bed uses ROS time: to pause and step the time, start the test bed with "
    "-p keep_clock:=true and all other nodes with -p use_sim_time:=true"
)


class Simulation(Protocol):
    """Interface of the simulation that a timeline advances."""

    @property
    def frame(self) -> int:
        """Number of the last simulated frame."""

    def make_frames(self, count: int) -> None:
        """Simulate frames."""

    def receive(self, delay: int) -> Iterable[int]:
        """Pass on datagrams as received `delay` ns after the last frame; yield each one's link."""

    def publish_clock(self, stamp: int) -> None:
        """Publish a time [ns] on /clock."""


class TimeStatus(NamedTuple):
    """State of the time, for diagnostics."""

    state: str
    is_slow: bool
    values: dict[str, Any]


class Timeline:
    """Time of a simulation, which follows a clock or keeps its own.

    Args:
        simulation: what is advanced; call `start` once it has a frame.
        keep_clock: publish the time, instead of following the ROS time.
        speed: speed of the kept time; 0: as fast as drivers can follow.
        paused: pause the kept time at the start.
        ros_time: reads the ROS time [ns].
    """

    pace: Pace

    def __init__(
        self,
        simulation: Simulation,
        keep_clock: bool,
        speed: float,
        paused: bool,
        ros_time: Callable[[], int],
    ) -> None:
        self.simulation, self.keep_clock, self.speed = simulation, keep_clock, speed
        self.paused, self.ros_time = paused, ros_time
        self.drivers, self.nodes = Followers(), Followers()
        self._clock_published = 0.0  # when the clock was last published [s]
        self._late_since: int | None = None  # ROS time since which frames are late [ns]

    def start(self) -> None:
        """Start the time at the present frame."""
        self.drivers.keep(set())
        self.nodes.keep(set())
        self.pace = self._new_pace()
        self._last_speed_check = self.simulation.frame, time.monotonic()

    def _new_pace(self) -> Pace:
        frame = self.simulation.frame
        if not self.keep_clock:
            return ClockPace(self.ros_time, frame, max_behind=SECOND, max_ahead=30 * SECOND)
        if not self.speed:
            return FullSpeedPace()
        # If frames cannot be computed in time, time runs slower, but a short stall is made up for.
        max_ahead = round(max(1.0, MAX_CATCH_UP * self.speed) * SECOND)
        return ClockPace(
            self._scaled_time, frame, max_behind=SECOND, max_ahead=max_ahead, speed=self.speed
        )

    def _scaled_time(self) -> int:
        return int(time.monotonic_ns() * self.speed)

    def stamp(self) -> int:
        """Return the time of the last frame [ns]; /clock starts at 1 s, as 0 is no time in ROS."""
        epoch = SECOND if self.keep_clock else self.pace.epoch
        return epoch + self.simulation.frame * FRAME

    def tick(self) -> float:
        """Simulate the frames that are due, and pass on the received datagrams.

        Returns:
            Time to wait before the next tick [s].
        """
        due = self._due_frames()
        for done in range(0, min(due, MAX_FRAMES_PER_TICK), FRAMES_PER_CLOCK):
            self._make_frames(min(due - done, FRAMES_PER_CLOCK))
            if self.keep_clock or self._is_too_slow():
                self._receive()
        # Check again: after a stall meanwhile, datagrams would be processed too early.
        if max(due, self._due_frames()) > MAX_FRAMES_PER_TICK:
            self._late_since = self._late_since or self.ros_time()
        else:
            self._late_since = None
            if not self.paused:
                self._receive()
        if self.paused and time.monotonic() - self._clock_published > PAUSED_CLOCK_PERIOD:
            self._publish_clock(self.stamp())  # for nodes that have started meanwhile
        return self.pace.check_period if due <= MAX_FRAMES_PER_TICK else 0.0

    def _is_too_slow(self) -> bool:
        """Return whether frames are late for more than MAX_DEAFNESS: datagrams do not wait then."""
        return self._late_since is not None and self.ros_time() - self._late_since > MAX_DEAFNESS

    def _due_frames(self) -> int:
        if self.paused:
            return 0
        frame = self.simulation.frame
        due = self.pace.due_frames(frame)
        for _, last in (self.drivers.slowest(), self.nodes.slowest()):
            if last is not None:
                due = min(due, max(0, last - frame))
        return due

    def _make_frames(self, count: int) -> None:
        """Simulate `count` frames; publish the clock first, so that no stamp is ahead of it."""
        if self.keep_clock:
            self._publish_clock(self.stamp() + count * FRAME)
        self.simulation.make_frames(count)

    def _publish_clock(self, stamp: int) -> None:
        self.simulation.publish_clock(stamp)
        self._clock_published = time.monotonic()

    def _receive(self) -> None:
        """Pass on datagrams as received now, or at the last frame if keep_clock is set."""
        frame = self.simulation.frame
        delay = 0 if self.keep_clock else min(max(self.pace.lag(frame), 0), FRAME - 1)
        for link in self.simulation.receive(delay):
            if self.keep_clock and not self.speed:
                self.drivers.record(f"driver of link {link + 1}", frame, MAX_LEAD, DRIVER_TIMEOUT)

    def record_node(self, name: str, stamp: int) -> None:
        """Record the time that a node has reached [ns]: the kept time waits for it."""
        frame = (stamp - SECOND) // FRAME
        self.nodes.record(name, frame, NODE_LEAD, NODE_TIMEOUT)

    def pause(self, paused: bool) -> str:
        """Pause or resume the time; return the reason why it cannot be paused, or ""."""
        if not self.keep_clock:
            return ROS_TIME
        self.paused, self.pace = paused, self._new_pace()
        return ""

    def step(self, frames: int) -> str:
        """Simulate frames while paused; return the reason why this is impossible, or ""."""
        if not self.keep_clock:
            return ROS_TIME
        if not self.paused:
            return "the clock is running: pause it first (service sim/pause)"
        if frames > MAX_FRAMES:
            return f"{frames} frames requested, expected at most {MAX_FRAMES}"
        for _ in range(frames):
            self._receive()
            self._make_frames(1)
        return ""

    def status(self) -> TimeStatus:
        """Return the state of the time, and its speed since the last call."""
        frame, now = self.simulation.frame, time.monotonic()
        last_frame, last_time = self._last_speed_check
        self._last_speed_check = frame, now
        speed = (frame - last_frame) / RATE / max(now - last_time, 1e-9)
        slowest, last_allowed = self.nodes.slowest()
        waits = last_allowed is not None and last_allowed <= frame  # in lockstep, for that node
        is_behind = now - last_time > 0.5 and speed < 0.95 * self.speed
        is_slow = is_behind and not (self.paused or waits)
        period = f"in the last {now - last_time:.0f} s"
        slow = f"too slow: {speed:.2f} instead of {self.speed:g} times real time {period}"
        state = "paused" if self.paused else slow if is_slow else "running"
        values: dict[str, Any] = {"simulated time [s]": frame / RATE, "speed": speed}
        values["VICON's frame"] = frame
        if slowest:
            values["slowest node"] = slowest
        if not self.keep_clock:
            values["clock jumps"] = self.pace.jumps
        return TimeStatus(state, is_slow, values)
