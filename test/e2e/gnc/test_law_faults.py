"""Laws that fail while they fly base and arm of the simulated test bed, by all its nodes."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from flight import flown

from fss_arm_ros.convert import stamp_ns

pytestmark = pytest.mark.slow
LAWS = Path(__file__).parents[2] / "support/flown_laws.py"
SPEED = 0.5  # of the time, that a busy computer keeps up with it
FAULTS = ("Exceptional", "Segmentation", "Endless", "Leak", "NotANumber", "Good")  # Good: SIGKILL
#: Lifetimes of a wrench and of joint commands, and half a second for the computer [s].
MAX_OPEN, MAX_MOVING = 0.8, 1.0
REST = 2e-3  # rate below which a joint is at rest [rad/s]


@pytest.fixture(scope="module")
def flyer(tmp_path_factory):
    with flown(tmp_path_factory.mktemp("nodes"), SPEED) as flyer:
        for name in ("guidance", "control"):
            flyer.nodes.stop(name)
        yield flyer


@pytest.mark.parametrize("fault", FAULTS)
def test_valves_close_and_joints_are_held_within_the_watchdog(flyer, fault, request):
    reports = []
    subscription = flyer.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 100)
    law = f"{LAWS}:{fault}"
    flyer.nodes.start("controller", "fss_gnc", "controller", law=law, use_sim_time=True)
    request.addfinalizer(lambda: flyer.nodes.stop("controller"))

    def values():
        """Return message and values of the node's last report."""
        found = [s for r in reports for s in r.status if s.name == "/controller"]
        if not found:
            return "", {}
        return found[-1].message, {v.key: v.value for v in found[-1].values}

    def is_moving(truth):
        return np.abs(truth.qd[3:]).max() > REST

    start_time = flyer.t
    flyer.until(lambda: flyer.t > start_time + 0.1 and any(flyer.truths[-1].valves))
    if fault == "Good":
        flyer.pass_time(1.0)
        os.kill(int(values()[1]["process"]), signal.SIGKILL)
    flyer.until(lambda: values()[0].startswith("law has failed"))
    flyer.pass_time(3.0)
    log = (flyer.nodes.logs / "controller.log").read_text()
    last = float(log.rpartition("its last valid output was for ")[2].partition(" s")[0])
    times = np.array([1e-9 * stamp_ns(t.header.stamp) for t in flyer.truths])
    opened = np.array([any(t.valves) for t in flyer.truths])
    moving = np.array([is_moving(t) for t in flyer.truths])
    before = (times > last - 1.0) & (times < last)
    assert opened[before].any()
    assert moving[before].any()
    open_time, moving_time = times[opened].max() - last, times[moving].max() - last
    print(
        f"{fault}: valves closed after {open_time:.2f} s, joints at rest after {moving_time:.2f} s"
    )
    assert open_time < MAX_OPEN
    assert moving_time < MAX_MOVING
    flyer.destroy_subscription(subscription)
