"""Time of the test bed: frames that are due at a pace, pauses and steps."""

import time

import numpy as np
import pytest

from fss_arm_model.units import SECOND
from fss_sim.pace import DRIVER_TIMEOUT, MAX_LEAD, NODE_LEAD, NODE_TIMEOUT, ClockPace
from fss_sim.testbed import FRAME
from fss_sim.timeline import (
    FRAMES_PER_CLOCK,
    MAX_DEAFNESS,
    MAX_FRAMES,
    MAX_FRAMES_PER_TICK,
    PAUSED_CLOCK_PERIOD,
    Timeline,
)


class Bench:
    """Simulation that counts; its ROS time is set by hand."""

    def __init__(self, keep_clock=False, speed=1.0, paused=False, frame=0):
        self.frame, self.now, self.events = frame, 0, []
        self.timeline = Timeline(self, keep_clock, speed, paused, lambda: self.now)
        self.timeline.start()

    def make_frames(self, count):
        self.frame += count
        self.events.append(("frames", count))

    def receive(self, delay):
        self.events.append(("receive", delay))
        return iter([0, 1])

    def publish_clock(self, stamp):
        self.events.append(("clock", stamp))

    def tick(self):
        """Tick; return the events."""
        self.events.clear()
        self.timeline.tick()
        return list(self.events)


@pytest.fixture
def real_time(monkeypatch):
    """Real time [s] that is set by hand."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "monotonic_ns", lambda: round(now[0] * SECOND))
    return now


def test_frames_follow_the_ros_time_and_datagrams_have_their_delay():
    bench = Bench(frame=7)
    bench.now = FRAME // 2
    assert bench.tick() == [("receive", FRAME // 2)]
    bench.now = 7 * FRAME + 3
    assert bench.tick() == [("frames", FRAMES_PER_CLOCK), ("frames", 2), ("receive", 3)]
    assert bench.timeline.stamp() == 7 * FRAME == bench.now - 3


def test_datagrams_received_during_a_stall_are_not_processed_early():
    bench, make = Bench(), Bench.make_frames

    def stall(count):
        make(bench, count)
        bench.now = 3 * SECOND

    bench.make_frames, bench.now = stall, 2 * FRAME
    assert bench.tick() == [("frames", 2)]
    while ("receive", 0) not in bench.tick():
        pass
    assert bench.frame == 300


def test_a_simulation_that_stays_late_reads_its_datagrams_regularly():
    bench, make = Bench(), Bench.make_frames

    def slow(count):  # half as fast as the clock
        make(bench, count)
        bench.now += 2 * count * FRAME

    bench.make_frames, bench.now = slow, 2 * SECOND
    read = [bench.now]
    bench.receive = lambda delay: read.append(bench.now) or iter([])
    while bench.now < 10 * SECOND:
        bench.tick()
    tick = 2 * MAX_FRAMES_PER_TICK * FRAME
    assert read[1] <= read[0] + MAX_DEAFNESS + 2 * tick
    assert max(np.diff(read[1:])) == 2 * FRAMES_PER_CLOCK * FRAME
    assert bench.timeline._due_frames() > MAX_FRAMES_PER_TICK


def test_late_frames_are_made_in_several_ticks():
    bench = Bench()
    bench.now = 2 * MAX_FRAMES_PER_TICK * FRAME
    bench.tick()
    assert bench.frame == MAX_FRAMES_PER_TICK
    assert bench.timeline.tick() > 0.0
    assert bench.frame == 2 * MAX_FRAMES_PER_TICK


def test_the_kept_clock_is_published_before_its_frames(real_time):
    bench = Bench(keep_clock=True, speed=2.0)
    real_time[0] += 4.001 * FRAME / SECOND
    first = SECOND + FRAMES_PER_CLOCK * FRAME
    expected = [("clock", first), ("frames", FRAMES_PER_CLOCK), ("receive", 0)]
    expected += [("clock", first + 3 * FRAME), ("frames", 3), ("receive", 0), ("receive", 0)]
    assert bench.tick() == expected


def test_a_paused_clock_is_repeated_and_steps(real_time):
    bench = Bench(keep_clock=True, paused=True)
    assert bench.tick() == [("clock", SECOND)]
    real_time[0] += 0.9 * PAUSED_CLOCK_PERIOD
    assert bench.tick() == []
    real_time[0] += 0.2 * PAUSED_CLOCK_PERIOD
    assert bench.tick() == [("clock", SECOND)]
    bench.events.clear()
    assert bench.timeline.step(2) == ""
    step = [("receive", 0), ("clock", SECOND + FRAME), ("frames", 1)]
    assert bench.events[:3] == step
    assert bench.frame == 2
    assert bench.timeline.status().state == "paused"
    assert bench.timeline.pause(False) == ""
    real_time[0] += 1.001 * FRAME / SECOND
    bench.tick()
    assert bench.frame == 3


def test_impossible_steps_and_pauses_are_refused():
    for keep_clock, paused, frames, reason in (
        (False, False, 1, "the test bed uses ROS time"),
        (True, False, 1, "the clock is running: pause it first"),
        (True, True, MAX_FRAMES + 1, f"{MAX_FRAMES + 1} frames requested, expected at most"),
    ):
        bench = Bench(keep_clock, paused=paused)
        assert bench.timeline.step(frames).startswith(reason)
        assert bench.frame == 0
    bench = Bench()
    assert bench.timeline.pause(True).startswith("the test bed uses ROS time")
    assert not bench.timeline.paused


def test_a_slow_simulation_is_reported(real_time):
    bench = Bench(keep_clock=True)
    slow = "too slow: 0.90 instead of 1 times real time in the last 1 s"
    for frames, state in ((100, "running"), (90, slow), (96, "running")):
        bench.frame += frames
        real_time[0] += 1.0
        status = bench.timeline.status()
        assert (status.state, status.is_slow) == (state, state == slow)
        assert status.values["speed"] == pytest.approx(frames / 100)


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_time_waits_for_a_slow_node_but_not_for_a_silent_one(real_time, speed):
    bench = Bench(keep_clock=True, speed=speed)
    for reached in (0, 5, 7):
        bench.timeline.record_node("/control", SECOND + (reached + 40) * FRAME)
        bench.timeline.record_node("/guidance", SECOND + reached * FRAME)
        for _ in range(5):
            real_time[0] += 0.2
            bench.tick()
        assert bench.frame == reached + NODE_LEAD
        status = bench.timeline.status()
        assert (status.values["slowest node"], status.is_slow) == ("/guidance", False)
    real_time[0] += NODE_TIMEOUT / SECOND
    bench.tick()
    real_time[0] += 0.2
    bench.tick()
    assert bench.frame > 7 + NODE_LEAD


def test_at_full_speed_time_waits_for_the_drivers(real_time):
    bench = Bench(keep_clock=True, speed=0.0)
    for _ in range(3):
        bench.tick()
    bench.receive = lambda delay: iter(())
    frame = bench.frame
    for _ in range(20):
        bench.tick()
    assert bench.frame == frame + MAX_LEAD
    real_time[0] += 1.1 * DRIVER_TIMEOUT / SECOND
    bench.tick()
    assert bench.frame > frame + MAX_LEAD


@pytest.mark.parametrize("speed", [0.5, 10.0])
def test_frames_follow_a_clock_at_the_given_speed_and_skip_its_jumps(speed):
    now, frame = 0, 0
    limits = {"max_behind": SECOND, "max_ahead": 10 * SECOND, "speed": speed}
    pace = ClockPace(lambda: round(speed * now), 0, **limits)
    for _ in range(200):  # 2 s of real time
        now += SECOND // 100
        frame += pace.due_frames(frame)
    assert frame == round(2 * speed * SECOND) // FRAME
    now += 30 * SECOND
    assert pace.due_frames(frame) == 0
    assert pace.jumps == 1
    now += 4 * FRAME
    assert pace.due_frames(frame) == 4 * speed
