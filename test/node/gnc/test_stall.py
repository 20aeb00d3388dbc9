"""A process `control` that stands still in the midst of a motion of the base, and goes on."""

import signal
import time

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import WrenchStamped
from guidance_bench import Bench

from fss_gnc.guidance.kinds import BASE

GO_TO = BASE[1]
PAUSE = 1.5  # [s]
MIN_FORCE = 0.01  # of a chase after the reference [N]


def test_control_does_not_chase_the_reference_after_a_stall(spin, start):
    bench = Bench(spin, max_age=3.0)  # of a busy computer
    control = start("fss_gnc.control_node", "--ros-args", "-p", "max_pause:=1.0")
    wrenches = []
    bench.create_subscription(
        WrenchStamped, "base/wrench", lambda m: wrenches.append(m.wrench.force), 10
    )
    bench.until(lambda: bench.count_publishers("base/wrench"), 60.0)
    bench.obeys = False  # the base stays where it is found
    handle = bench.begin(GO_TO, pose=[0.5, 0.0, 0.0])
    ended = handle.get_result_async()
    bench.until(lambda: wrenches and wrenches[-1].x > MIN_FORCE)

    control.process.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    bench.until(lambda: time.monotonic() > stopped + PAUSE)
    before = len(wrenches)
    control.process.send_signal(signal.SIGCONT)
    bench.until(ended.done)
    message = ended.result().result.message
    print(message, [round(force.x, 3) for force in wrenches[before:]])
    assert ended.result().status == GoalStatus.STATUS_ABORTED
    assert message.startswith("control paused for ")
    assert PAUSE - 0.2 < float(message.split()[3]) < PAUSE + 2.0
    assert len(wrenches) > before  # it holds
    assert np.abs([force.x for force in wrenches[before:]]).max() < MIN_FORCE

    handle = bench.begin(GO_TO, pose=[0.5, 0.0, 0.0])
    bench.until(lambda: wrenches[-1].x > MIN_FORCE)
