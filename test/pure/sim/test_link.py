"""A link of the test bed: power, clock, and the peer of its telemetry."""

from dataclasses import replace

import driver_frames
import pytest

from fss_arm_driver.protocol import Slow, decode, encode
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_sim import testbed
from fss_sim.faults import Event, LinkFaults
from fss_sim.link.link import Link
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.vehicle import Motion
from fss_sim.testbed import FRAME, State

REST = Motion(q=0.5, qd=0.0, current=0.25, torque=0.2)
START = State(frame=0, boots=1, rests=0, q=(0.0,) * 7, qd=(0.0,) * 7, boot_offset=0)
DISARM = replace(driver_frames.DISARM, link=1, boot=0)


def started_link(noise=PRESETS["ideal"], **options):
    link = Link(1, paper_arm().links[0], noise, seed=1, run=1, **options)
    link.start(1, 0)
    return link


def reports(link, seconds, start=0):
    times = range(start + FRAME, start + round(seconds * SECOND) + 1, FRAME)
    return [d for t in times for d in link.report(t, REST, 0.01)]


def test_its_clock_has_the_stated_drift():
    drifts = []
    for seed in range(400):
        link = Link(1, paper_arm().links[0], Noise(clock_drift=2e-5), seed, run=1)
        link.start(1, 0)
        for t in range(1000 * SECOND, 1000 * SECOND + SECOND // 5, FRAME):
            if got := link.report(t, REST, 0.01):
                drifts.append(decode(got[0].data).clock / (t * 1e-3) - 1.0)
                break
    assert (sum(d * d for d in drifts) / 400) ** 0.5 == pytest.approx(2e-5, rel=0.15)


def test_telemetry_is_sent_to_the_peer_of_the_last_accepted_command():
    link = started_link()
    assert {d.peer for d in reports(link, 1.0)} == {None}
    link.receive(encode(DISARM), "a", SECOND)
    link.receive(b"noise", "b", SECOND)
    assert {d.peer for d in reports(link, 1.0, SECOND)} == {"a"}


def test_a_delayed_command_is_accepted_when_it_arrives():
    link = started_link()
    link.receive(encode(DISARM), "a", SECOND, LinkFaults(delay=0.1))
    link.demand(SECOND + 90_000_000, REST)
    assert link.electronics.gate.command is None
    link.demand(SECOND + 100_000_000, REST)
    assert link.electronics.gate.command.clock == DISARM.clock


def test_a_dead_link_is_silent_and_restarts_disarmed_with_another_boot():
    script = [Event(0.5, "link_2", "dead", duration=0.3), Event(1.0, "link_3", "dead")]
    bed = testbed.Testbed(paper_arm(), PRESETS["ideal"], 1, START, rate=100.0, script=script)
    frames = [decode(d.data) for _ in range(200) for link in bed.step().telemetry for d in link]
    boots = {i: [f.boot for f in frames if f.link == i] for i in (1, 2, 3)}
    assert boots[1] == [1] * 200
    assert boots[2] == [1] * 50 + [2] * 120
    assert boots[3] == [1] * 100
    assert bed.state().after_restart().boots == 3  # not used by any link
    restarted = next(f for f in frames if f.link == 2 and f.boot == 2)
    assert restarted.clock <= 10_000
    assert restarted.sequence == 0


def test_a_link_reports_the_voltage_of_its_battery():
    link = started_link(charge=1.0)
    frames = [decode(d.data) for d in reports(link, 5.0)]
    volts = [f.slow_value for f in frames if f.slow_id == Slow.BATTERY]
    assert 165 <= volts[-1] <= 168
