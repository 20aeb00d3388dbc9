"""The driver's node and the firmware's own code: a link left alone stops; one driver has it."""

import signal
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from firmware import LINK, firmware_url
from std_srvs.srv import SetBool
from turn_person import TurnPerson

from fss_arm_driver.protocol import State, Telemetry, decode
from fss_arm_driver.transport import open_transport

KEY = bytes(range(16))
SECOND = 1_000_000
slow = partial(pytest.param, marks=pytest.mark.slow)


@pytest.fixture
def keys(keys_file) -> Path:
    return keys_file({1: KEY})


@pytest.fixture
def url(request, keys) -> Iterator[str]:
    """Where the firmware, as a process, is."""
    with firmware_url(LINK, request.param, keys) as url:
        yield url


def arguments(url, keys):
    parameters = ("-p", "link:=1", "-p", f"url:={url}", "-p", f"keys:={keys}")
    return "fss_arm_driver.link_node", "--ros-args", *parameters


def begin(spin, nodes, person):
    """The driver has its link: armed, and turning."""
    spin(nodes, lambda: person.joint and person.arming.service_is_ready(), 30.0)
    armed = person.arming.call_async(SetBool.Request(data=True))
    assert spin(nodes, armed.done, 20.0)
    assert armed.result().success, armed.result().message
    spin(nodes, person.turning, 20.0)


@pytest.mark.parametrize("url", ["--pty", *map(slow, ("--udp 0", "--tcp 0"))], indirect=True)
def test_a_link_whose_driver_was_killed_stops_within_the_watchdog_time(spin, start, url, keys):
    driver = start(*arguments(url, keys))
    person = TurnPerson()
    begin(spin, [person], person)
    driver.stop(signal.SIGKILL)

    transport = open_transport(url)
    frames: list[Telemetry] = []

    def listen() -> bool:
        transport.wait(0.1)
        frames.extend(decode(data, KEY) for data in transport.receive())
        return bool(frames) and frames[-1].turnaround > 3.5 * SECOND

    spin(person, listen, 20.0)
    transport.close()
    tripped = [frame for frame in frames if frame.flags & State.WATCHDOG]
    before = [frame for frame in frames if not frame.flags & State.WATCHDOG]
    assert all(frame.velocity > 0 for frame in before)
    assert before[-1].turnaround <= 2.0 * SECOND
    assert tripped[0].turnaround < 3.5 * SECOND  # a stall of this machine included
    assert tripped[-1].velocity == 0
    assert not tripped[-1].flags & State.ARMED
    assert tripped[-1].position < 50_000  # of the 57 000 counts commanded


@pytest.mark.parametrize("url", ["--udp 0", *map(slow, ("--tcp 0", "--pty"))], indirect=True)
def test_a_driver_that_was_stopped_and_goes_on_moves_nothing(spin, start, url, keys):
    driver = start(*arguments(url, keys))
    person = TurnPerson()
    begin(spin, [person], person)
    driver.process.send_signal(signal.SIGSTOP)
    until = time.monotonic() + 5.0
    asked = person.arming.call_async(SetBool.Request(data=True))
    spin(person, lambda: person.turn() or time.monotonic() > until)
    held = len(person.positions)
    driver.process.send_signal(signal.SIGCONT)
    spin(person, lambda: len(person.positions) > held + 15)
    answer = asked.result()
    assert not answer.success
    # What came first may have been measured before it was stopped.
    assert max(person.positions[held + 3 :]) - min(person.positions[held + 3 :]) < 1e-4
    assert "disarmed" in person.health[url].message
    assert driver.output.count("was stalled for 5") == 1
    begin(spin, [person], person)
