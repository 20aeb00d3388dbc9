"""Base and arm flown by nodes on the simulated test bed, and nodes killed while they fly."""

import signal

import numpy as np
import pytest
from flight import flown

from fss_arm_ros.convert import stamp_ns

pytestmark = pytest.mark.slow
SPEED = 0.5  # of the time, that a busy computer keeps up with it
#: After which valves must be shut: what it said lives so long, and half a second for the computer.
LIMITS = {"guidance": 1.5, "navigation": 1.1, "control": 0.8}


@pytest.fixture(scope="module")
def flyer(tmp_path_factory):
    with flown(tmp_path_factory.mktemp("nodes"), SPEED) as flyer:
        flyer.stop_drifting()  # and all is under way
        yield flyer


def pose(flyer):
    return np.array(flyer.truths[-1].q[:3])


def test_the_base_is_held_while_the_arm_moves(flyer):
    handle = flyer.holding()
    flyer.pass_time(2.0)
    here, since = pose(flyer), flyer.t
    moved = flyer.does("arm/move", q=[0.15, -0.3, 0.2, -0.1], duration=20.0).result
    assert moved.reached, moved.message
    flyer.pass_time(2.0)
    offset, turned = flyer.off(here, since)
    print(f"{1e3 * offset:.2f} mm, {turned:.3f} deg, {1e3 * flyer.truths[-1].propellant:.2f} g")
    assert offset < 0.01
    assert turned < 1.0
    flyer.after(handle.cancel_goal_async())
    result = flyer.end(handle).result
    assert result.held, result.message
    assert result.propellant == pytest.approx(flyer.truths[-1].propellant, abs=0.005)


@pytest.mark.parametrize("name", LIMITS)
def test_whoever_is_killed_leaves_no_valve_open(flyer, name):
    away = pose(flyer) - np.array([0.3, 0.0, 0.0])
    handle = flyer.send("base/go_to", pose=away.tolist())
    flyer.until(lambda: flyer.states[-1].phase == "go_to")
    flyer.pass_time(3.0)
    flyer.nodes.processes[name].send_signal(signal.SIGKILL)
    flyer.nodes.processes[name].wait()
    killed = flyer.t
    flyer.pass_time(LIMITS[name] + 4.0)
    times = np.array([1e-9 * stamp_ns(t.header.stamp) for t in flyer.truths])
    opened = np.array([any(t.valves) for t in flyer.truths])
    assert opened[(times > killed - 3.0) & (times < killed)].any()
    last = times[opened].max() - killed
    print(f"{name} killed: the last valve shut after {last:.2f} s")
    assert last < LIMITS[name]
    flyer.nodes.restart_killed()
    if name == "guidance":
        flyer.until(lambda: flyer.states[-1].phase == "idle")
    else:
        flyer.after(handle.cancel_goal_async())
        flyer.end(handle)
    flyer.stop_drifting()
