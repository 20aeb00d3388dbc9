"""When frames are due: by a clock, or as fast as the drivers follow."""

from fss_sim.pace import DRIVER_TIMEOUT, LEAD, STRIDE, Clocked, FlatOut
from fss_sim.testbed import FRAME


def test_late_frames_are_made_up_for_and_a_clock_that_was_set_is_followed():
    now = 0
    pace = Clocked(lambda: now, frame=5, back=10 * FRAME, ahead=20 * FRAME)
    assert pace.due(5) == 0
    now = 7 * FRAME + 1
    assert (pace.due(5), pace.due(12), pace.jumps) == (7, 0, 0)
    now += 50 * FRAME
    assert (pace.due(12), pace.jumps) == (0, 1)
    now += FRAME
    assert pace.due(12) == 1


def test_flat_out_goes_on_alone_waits_for_drivers_and_gives_up_those_that_ended():
    now = 0
    pace = FlatOut(lambda: now)
    assert pace.due(100) == STRIDE
    pace.hear(0, 100)
    pace.hear(1, 103)
    assert pace.due(100) == STRIDE
    assert pace.due(100 + LEAD - 3) == 3
    assert pace.due(100 + LEAD) == 0
    pace.hear(0, 100 + LEAD)
    assert pace.due(100 + LEAD) == 3
    now = DRIVER_TIMEOUT + 1
    assert pace.due(103 + LEAD) == STRIDE
