"""Pace of the simulator: times at which frames are due."""

import pytest

from fss_arm_model.units import SECOND
from fss_sim.pace import ClockPace
from fss_sim.testbed import FRAME


class ManualClock:
    """A clock set by hand [ns]."""

    def __init__(self):
        self.time = 0

    def __call__(self):
        return self.time


@pytest.mark.parametrize("speed", [0.5, 1.0, 10.0])
def test_frames_follow_a_clock_at_the_given_speed(speed):
    clock = ManualClock()
    pace = ClockPace(
        lambda: round(speed * clock()), 0, max_behind=SECOND, max_ahead=10 * SECOND, speed=speed
    )
    frame = 0
    for _ in range(200):  # 2 s of real time
        clock.time += SECOND // 100
        frame += pace.due_frames(frame)
    assert frame == round(2 * speed * SECOND) // FRAME


def test_late_frames_are_simulated_later_but_clock_jumps_are_skipped():
    clock = ManualClock()
    pace = ClockPace(clock, 0, max_behind=SECOND, max_ahead=10 * SECOND)
    clock.time = 3 * SECOND
    assert pace.due_frames(0) == 3 * SECOND // FRAME
    clock.time += 20 * SECOND
    assert pace.due_frames(300) == 0
    assert pace.jumps == 1
    clock.time += 2 * FRAME
    assert pace.due_frames(300) == 2
