"""Rehearse a Wi-Fi outage while the arm moves: links stop and wait until an operator arms them.

The rehearsal runs in real time, with all links on one radio channel. A program publishes commands
throughout, as if it had not noticed the outage. The operator arms the links again after the Wi-Fi
has returned.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from fss_arm_bags.reader import open_bags
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros import palette
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.report import Figure
from fss_rehearsal.domain import Domain
from fss_rehearsal.operators import LINKS, Mover, isolated_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.rehearsed import Check, Rehearsed

REST_RATE = 1e-3  # rate below which a joint rests [rad/s]
#: Watchdog of the links; margin for transport delay, braking, and a busy computer [s].
WATCHDOG, MARGIN = 2.0, 1.5
RETURN_TIMEOUT = 5.0  # timeout until telemetry of a link is received again [s]


class OutageOperator(Mover):
    """Operator that interrupts and restores the Wi-Fi."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain)
        self.received_at = dict.fromkeys(self.armed, 0)

    def on_link(self, message: LinkTelemetry) -> None:
        """Store whether the link is armed, and when its telemetry was received."""
        super().on_link(message)
        self.received_at[message.link] = self.now()

    def set_outage(self, on: bool) -> int:
        """Start or end the outage of all links; return when it was set [ns]."""
        return self.set_faults({f"link_{i}.loss": float(on) for i in self.armed})


class Times(NamedTuple):
    """Times of the rehearsal's events [ns]."""

    turning: int
    cut: int
    back: int
    again: int  # arming requested
    end: int


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this rehearsal."""
    parser.add_argument(
        "--outage", type=float, default=6.0, help="duration of the outage [s] (default 6)"
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
        wifi=True,
        truth_rate=50.0,
        telemetry_rate=20.0,
    )
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        nodes.start(
            f"link_{i}", "fss_arm_driver", "link", link=i, url=url, watchdog=WATCHDOG, rate=20.0
        )
    nodes.start("arm", "fss_arm_driver", "arm")


def run_scenario(operator: OutageOperator, outage: float) -> Times:
    """Turn the joints, cut and restore the Wi-Fi, arm again; return when each happened."""
    turning, cut = operator.arm_and_turn(), operator.set_outage(True)
    operator.wait_until(cut + int(outage * SECOND))
    back = operator.set_outage(False)
    operator.wait(
        lambda: min(operator.received_at.values()) > back,
        "no telemetry of all links after the Wi-Fi returned",
    )
    arm_time = operator.now() + 2 * SECOND
    operator.wait_until(arm_time)
    return Times(turning, cut, back, arm_time, operator.arm_and_turn())


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Cut and restore the Wi-Fi, then evaluate the bag."""
    with isolated_domain() as domain, Nodes(out / "logs", console.print, domain) as nodes:
        console.print(f"starting all nodes in their own ROS domain, {domain.number}")
        start_all(nodes, options, out)
        operator = OutageOperator(domain)
        times = run_scenario(operator, options.outage)
        operator.destroy_node()
    names = {f"/link_{i}/telemetry" for i in range(1, LINKS + 1)}
    with open_bags(out / "bag") as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
        telemetry = [message for _, _, _, message in bags.messages(names)]
    t = np.array([stamp_ns(message.header.stamp) for message in truths])
    rates = np.array([message.qd[3:] for message in truths])
    checks = evaluate(times, t, rates, telemetry)
    figure = Figure("wifi_outage", "Rates of the joints", partial(plot, times, t, rates))
    return Rehearsed(checks, [figure], files={"bag": "recording", "logs": "logs of the nodes"})


def evaluate(times: Times, t: np.ndarray, rates: np.ndarray, telemetry: list[Any]) -> list[Check]:
    """Compare the recording with what is expected.

    Args:
        times: times of the events.
        t: (k,) times of the truth [ns].
        rates: (k, n) joint rates [rad/s].
        telemetry: messages of all links.
    """
    fastest = np.abs(rates).max(axis=1)
    moved = t[(fastest > REST_RATE) & (t < times.again)]
    stopped = (moved.max() - times.cut) / SECOND if len(moved) else np.inf
    rates_while_stopped = fastest[
        (t > times.cut + (WATCHDOG + MARGIN) * SECOND) & (t < times.again)
    ]
    fastest_stopped = rates_while_stopped.max(initial=0.0)
    first_frames = {}
    for message in telemetry:
        at = stamp_ns(message.header.stamp)
        if times.back < at < times.again and message.link not in first_frames:
            first_frames[message.link] = (at - times.back) / SECOND, bool(message.armed)
    delay = max((at for at, _ in first_frames.values()), default=np.inf)
    received = f"{len(first_frames)} of {LINKS} after {delay:.1f} s"
    armed = [f"link_{i}" for i, (_, is_armed) in first_frames.items() if is_armed]
    rates_after = np.abs(rates[t > times.again])
    return [
        Check(
            "the joints turn before the outage",
            f"at {fastest[t < times.cut][-1]:.3f} rad/s",
            bool(fastest[t < times.cut][-1] > Mover.MOVING_RATE),
        ),
        Check(
            f"the watchdogs stop all joints {WATCHDOG:g} s after the last command",
            f"{stopped:.1f} s after the cut",
            bool(stopped < WATCHDOG + MARGIN),
        ),
        Check(
            "nothing moves until the links are armed again, despite commands",
            f"at most {fastest_stopped:.1e} rad/s",
            bool(fastest_stopped < REST_RATE),
        ),
        Check(
            f"telemetry of all links is received within {RETURN_TIMEOUT:g} s after its return",
            received,
            len(first_frames) == LINKS and delay < RETURN_TIMEOUT,
        ),
        Check(
            "they return disarmed",
            ", ".join(armed) + " armed" if armed else "none is armed",
            not armed,
        ),
        Check(
            "after arming, all joints turn",
            f"the slowest at up to {rates_after.max(axis=0, initial=0.0).min():.3f} rad/s",
            bool(rates_after.max(axis=0, initial=0.0).min() > Mover.MOVING_RATE),
        ),
    ]


def plot(times: Times, t: np.ndarray, rates: np.ndarray) -> Any:
    """Draw the joint rates, with the outage shaded."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(10.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    since, until, arming = (
        (at - times.cut) / SECOND for at in (times.cut, times.back, times.again)
    )
    axes.axvspan(since, until, color="0.85", label="no Wi-Fi")
    axes.axvline(since + WATCHDOG, color="0.5", ls="--", lw=0.8, label="earliest watchdog stop")
    axes.axvline(arming, color=palette.POSITIVE, ls="--", lw=0.8, label="armed again from here")
    for k, line in enumerate(rates.T, 1):
        axes.plot((t - times.cut) / SECOND, line, lw=1, label=f"joint {k}")
    axes.set(xlabel="time after the cut [s]", ylabel="rate [rad/s]")
    axes.legend(fontsize=8)
    return figure
