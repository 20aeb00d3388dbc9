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
from fss_arm_calib.report import Figure
from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_rehearsal.domain import Domain
from fss_rehearsal.person import LINKS, Mover, own_domain
from fss_rehearsal.processes import Nodes
from fss_rehearsal.rehearsed import Check, Rehearsed

BACK = 5.0  # timeout until telemetry of the link is received again [s]
SILENT = 1.0  # time after the power failure after which the link sends no frames [s]


class Person(Mover):
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
        self.arms, self.homes = True, {self.link}
        found = f"link {self.link} does not find its reference"
        self.wait(lambda: bool(self.last.flags & State.REFERENCED), found)
        self.homes = set()
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
    parser.add_argument("--link", type=int, default=2, choices=range(1, LINKS + 1), help="which")
    parser.add_argument("--outage", type=float, default=4.0, help="how long it lasts [s]")


def start_all(nodes: Nodes, options: argparse.Namespace, out: Path) -> None:
    """Start all nodes."""
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag")
    nodes.start(
        "testbed", "fss_sim", "testbed", ports=nodes.domain.ports(LINKS), seed=options.seed,
        truth_rate=50.0, telemetry_rate=20.0,
    )  # fmt: skip
    for i, url in enumerate(nodes.domain.urls(LINKS), 1):
        nodes.start(f"link_{i}", "fss_arm_driver", "link", link=i, url=url, rate=20.0)
    nodes.start("arm", "fss_arm_driver", "arm")


def act(person: Person, outage: float) -> Times:
    """Turn the joints, cut and restore the power, home the link; return when each happened."""
    person.turn()
    boot = person.last.boot
    cut = person.put({f"link_{person.link}.dead": 1.0})
    person.stay(cut + int(outage * SECOND))
    back = person.put({f"link_{person.link}.dead": 0.0})
    person.wait(lambda: person.last.boot != boot, f"link {person.link} is not heard again")
    calm = person.now() + 2 * SECOND
    person.stay(calm)
    homed = person.home()
    goal, moving = person.link - 1, Mover.MOVING
    person.wait(lambda: bool(person.rates[goal] > moving), "the joint does not turn again")
    end = person.now() + SECOND
    person.stay(end)
    return Times(cut, back, calm, homed, end)


def run(options: argparse.Namespace, out: Path, console: Console) -> Rehearsed:
    """Cut and restore the power, then evaluate the bag."""
    with own_domain() as domain, Nodes(out / "logs", console.print, domain) as nodes:
        console.print(f"starting simulator, drivers and recorder, in ROS domain {domain.number}")
        start_all(nodes, options, out)
        person = Person(domain, options.link)
        times = act(person, options.outage)
        person.destroy_node()
    with open_bags(out / "bag") as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
        name = f"/link_{options.link}/telemetry"
        telemetry = [message for _, _, _, message in bags.messages({name})]
    t = np.array([stamp_ns(message.header.stamp) for message in truths])
    rate = np.array([message.qd[2 + options.link] for message in truths])
    checks = judge(times, t, rate, telemetry)
    drawn = partial(plot, times, t, rate)
    figure = Figure("power_failure", f"The rate of joint {options.link}", drawn)
    return Rehearsed(checks, [figure], files={"bag": "recording", "logs": "of the nodes"})


def judge(times: Times, t: np.ndarray, rate: np.ndarray, telemetry: Sequence[Any]) -> list[Check]:
    """Compare the recording with what is expected.

    Args:
        times: times of the events.
        t: (k,) times of the truth [ns].
        rate: (k,) rate of the link's joint [rad/s].
        telemetry: messages of the link.
    """
    at = np.array([stamp_ns(message.header.stamp) for message in telemetry])
    before, after = np.abs(rate[t < times.cut]), np.abs(rate[t > times.homed])
    mute = np.count_nonzero((at > times.cut + SILENT * SECOND) & (at < times.back))
    heard = [m for m, when in zip(telemetry, at, strict=True) if times.back < when < times.armed]
    late = (stamp_ns(heard[0].header.stamp) - times.back) / SECOND if heard else np.inf
    said = heard[0].flags if heard else 0
    # Without torque the joint may turn because the others move; its drive must be off.
    driven = sum(bool(message.mode) for message in heard)
    referenced = bool(telemetry[-1].flags & State.REFERENCED)
    fast, again = before.max(initial=0.0), after.max(initial=0.0)
    return [
        Check("the joint turns before it", f"at up to {fast:.3f} rad/s", bool(fast > Mover.MOVING)),
        Check("without power the link is silent", f"{mute} frames", mute == 0),
        Check(f"it is heard within {BACK:g} s of its power's return", f"after {late:.1f} s",
              bool(late < BACK)),
        Check("it comes back disarmed", "armed" if said & State.ARMED else "disarmed",
              bool(heard) and not said & State.ARMED),
        Check("it comes back without its reference",
              "referenced" if said & State.REFERENCED else "not referenced",
              bool(heard) and not said & State.REFERENCED),
        Check("its drive is off until it is armed again, whatever is commanded",
              f"on in {driven} of {len(heard)} frames", bool(heard) and driven == 0),
        Check("armed and homed, it is referenced",
              f"{(times.homed - times.armed) / SECOND:.1f} s after it was asked for", referenced),
        Check("then the joint turns again", f"at up to {again:.3f} rad/s",
              bool(again > Mover.MOVING)),
    ]  # fmt: skip


def plot(times: Times, t: np.ndarray, rate: np.ndarray) -> Any:
    """Draw the joint rate, with the failure shaded."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(10.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    since, until, armed, homed = ((at - times.cut) / SECOND for at in times[:4])
    axes.axvspan(since, until, color="0.85", label="no power")
    axes.axvspan(armed, homed, color="C2", alpha=0.15, label="armed, and homed")
    axes.plot((t - times.cut) / SECOND, rate, lw=1)
    axes.set(xlabel="time after the cut [s]", ylabel="rate [rad/s]")
    axes.legend(fontsize=8)
    return figure
