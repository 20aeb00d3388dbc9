"""When the simulator's frames are due."""

import pytest

from fss_sim.pace import Clocked
from fss_sim.testbed import FRAME

SECOND = 1_000_000_000


class Hand:
    """A clock set by hand [ns]."""

    def __init__(self):
        self.time = 0

    def __call__(self):
        return self.time


@pytest.mark.parametrize("speed", [0.5, 1.0, 10.0])
def test_frames_follow_a_clock_at_the_speed_asked_for(speed):
    hand = Hand()
    pace = Clocked(lambda: round(speed * hand()), 0, back=SECOND, ahead=10 * SECOND, speed=speed)
    frame = 0
    for _ in range(200):  # 2 s of real time
        hand.time += SECOND // 100
        frame += pace.due(frame)
    assert frame == round(2 * speed * SECOND) // FRAME


def test_a_late_frame_is_made_up_for_but_a_jump_of_the_clock_is_not():
    hand = Hand()
    pace = Clocked(hand, 0, back=SECOND, ahead=10 * SECOND)
    hand.time = 3 * SECOND
    assert pace.due(0) == 3 * SECOND // FRAME
    hand.time += 20 * SECOND
    assert pace.due(300) == 0
    assert pace.jumps == 1
    hand.time += 2 * FRAME
    assert pace.due(300) == 2
