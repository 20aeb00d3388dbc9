"""Rehearse a power failure of one link while the arm moves: it restarts disarmed and is homed.

The rehearsal runs in real time. A program publishes commands throughout, as if it had not noticed
the failure. After power has returned, the operator arms the link again and homes it.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from fss_arm_bags.reader import open_bags
from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros import palette
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.report import Figure
from fss_rehearsal.domain import Domain
from fss_rehearsal.operators import LINKS, Mover, isolated_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.rehearsed import Check, Rehearsed

RETURN_TIMEOUT = 5.0  # timeout until telemetry of the link is received again [s]
SILENT_AFTER = 1.0  # time after the power failure after which the link sends no frames [s]


class PowerOperator(Mover):
    """Operator that cuts and restores the power of a link, arms it and homes it."""

    def __init__(self, domain: Domain, link: int) -> None:
        super().__init__(domain)
        self.link, self.last = link, LinkTelemetry()

    def on_link(self, message: LinkTelemetry) -> None:
        """Store the newest telemetry of the link."""
        super().on_link(message)
        if message.link == self.link:
            self.last = message

    def home(self) -> int:
        """Arm the link and home it; return when it has found its reference [ns]."""
        self.arming, self.homing = True, {self.link}
        found = f"link {self.link} does not find its reference"
        self.wait(lambda: bool(self.last.flags & State.REFERENCED), found)
        self.homing = set()
        return self.now()


class Times(NamedTuple):
    """Times of the rehearsal's events [ns]."""

    cut: int
    back: int
    armed: int  # arming requested
    homed: int
    end: int


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--link",
        type=int,
        default=2,
        choices=range(1, LINKS + 1),
        help="link without power (default 2)",
    )
    parser.add_argument(
        "--outage", type=float, default=4.0, help="duration of the failure [s] (default 4)"
    )


def start_all(nodes: Nodes, options: argparse.Namespace, out: Path) -> None:
    """Start all nodes."""
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag")
    nodes.start(
        "testbed",
        "fss_sim",
        "testbed",
        ports=nodes.domain.ports(LINKS),
        seed=options.seed,
        truth_rate=50.0,
        telemetry_rate=20.0,
    )
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        nodes.start(f"link_{i}", "fss_arm_driver", "link", link=i, url=url, rate=20.0)
    nodes.start("arm", "fss_arm_driver", "arm")


def run_scenario(operator: PowerOperator, outage: float) -> Times:
    """Turn the joints, cut and restore the power, home the link; return when each happened."""
    operator.arm_and_turn()
    boot = operator.last.boot
    cut = operator.set_faults({f"link_{operator.link}.dead": 1.0})
    operator.wait_until(cut + int(outage * SECOND))
    back = operator.set_faults({f"link_{operator.link}.dead": 0.0})
    operator.wait(
        lambda: operator.last.boot != boot,
        f"no telemetry of link {operator.link} after the power returned",
    )
    arm_time = operator.now() + 2 * SECOND
    operator.wait_until(arm_time)
    homed = operator.home()
    joint, moving_rate = operator.link - 1, Mover.MOVING_RATE
    operator.wait(
        lambda: bool(operator.rates[joint] > moving_rate), "the joint does not turn after homing"
    )
    end = operator.now() + SECOND
    operator.wait_until(end)
    return Times(cut, back, arm_time, homed, end)


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Cut and restore the power, then evaluate the bag."""
    with isolated_domain() as domain, Nodes(out / "logs", console.print, domain) as nodes:
        console.print(f"starting all nodes in their own ROS domain, {domain.number}")
        start_all(nodes, options, out)
        operator = PowerOperator(domain, options.link)
        times = run_scenario(operator, options.outage)
        operator.destroy_node()
    with open_bags(out / "bag") as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
        name = f"/link_{options.link}/telemetry"
        telemetry = [message for _, _, _, message in bags.messages({name})]
    t = np.array([stamp_ns(message.header.stamp) for message in truths])
    rate = np.array([message.qd[2 + options.link] for message in truths])
    checks = evaluate(times, t, rate, telemetry)
    draw = partial(plot, times, t, rate)
    figure = Figure("power_failure", f"Rate of joint {options.link}", draw)
    return Rehearsed(checks, [figure], files={"bag": "recording", "logs": "logs of the nodes"})


def evaluate(
    times: Times, t: np.ndarray, rate: np.ndarray, telemetry: Sequence[Any]
) -> list[Check]:
    """Compare the recording with what is expected.

    Args:
        times: times of the events.
        t: (k,) times of the truth [ns].
        rate: (k,) rate of the link's joint [rad/s].
        telemetry: messages of the link.
    """
    at = np.array([stamp_ns(message.header.stamp) for message in telemetry])
    before, after = np.abs(rate[t < times.cut]), np.abs(rate[t > times.homed])
    frames_while_off = np.count_nonzero(
        (at > times.cut + SILENT_AFTER * SECOND) & (at < times.back)
    )
    received = [m for m, when in zip(telemetry, at, strict=True) if times.back < when < times.armed]
    delay = (stamp_ns(received[0].header.stamp) - times.back) / SECOND if received else np.inf
    flags = received[0].flags if received else 0
    # Without torque the joint may turn because the others move; its drive must be off.
    driven = sum(bool(message.mode) for message in received)
    referenced = bool(telemetry[-1].flags & State.REFERENCED)
    rate_before, rate_after = before.max(initial=0.0), after.max(initial=0.0)
    return [
        Check(
            "the joint turns before the failure",
            f"at up to {rate_before:.3f} rad/s",
            bool(rate_before > Mover.MOVING_RATE),
        ),
        Check(
            "without power the link sends no frames",
            f"{frames_while_off} frames",
            frames_while_off == 0,
        ),
        Check(
            f"its telemetry is received within {RETURN_TIMEOUT:g} s after the power returned",
            f"after {delay:.1f} s",
            bool(delay < RETURN_TIMEOUT),
        ),
        Check(
            "it restarts disarmed",
            "armed" if flags & State.ARMED else "disarmed",
            bool(received) and not flags & State.ARMED,
        ),
        Check(
            "it restarts without its reference",
            "referenced" if flags & State.REFERENCED else "not referenced",
            bool(received) and not flags & State.REFERENCED,
        ),
        Check(
            "its drive stays off until it is armed again, despite commands",
            f"on in {driven} of {len(received)} frames",
            bool(received) and driven == 0,
        ),
        Check(
            "after arming and homing, it is referenced",
            f"{(times.homed - times.armed) / SECOND:.1f} s after the request",
            referenced,
        ),
        Check(
            "after homing, the joint turns again",
            f"at up to {rate_after:.3f} rad/s",
            bool(rate_after > Mover.MOVING_RATE),
        ),
    ]


def plot(times: Times, t: np.ndarray, rate: np.ndarray) -> Any:
    """Draw the joint rate, with the failure shaded."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(10.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    since, until, armed, homed = ((at - times.cut) / SECOND for at in times[:4])
    axes.axvspan(since, until, color="0.85", label="no power")
    axes.axvspan(armed, homed, color=palette.POSITIVE, alpha=0.15, label="arming and homing")
    axes.plot((t - times.cut) / SECOND, rate, lw=1)
    axes.set(xlabel="time after the cut [s]", ylabel="rate [rad/s]")
    axes.legend(fontsize=8)
    return figure
