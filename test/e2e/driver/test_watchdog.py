"""The driver's node and the firmware's own code: a link left alone stops; one driver has it."""

import signal
import subprocess
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from firmware import build
from rclpy.parameter import Parameter
from running import free_port
from std_srvs.srv import SetBool
from turn_person import TurnPerson

from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.protocol import State, Telemetry, decode
from fss_arm_driver.transport import open_transport
from fss_link.host_clock import HostClock

KEY = bytes(range(16))
SECOND = 1_000_000
slow = partial(pytest.param, marks=pytest.mark.slow)


@pytest.fixture
def keys(keys_file) -> Path:
    return keys_file({1: KEY})


@pytest.fixture
def url(request, keys, start) -> Iterator[str]:
    """Where the firmware, as a process, is, or a link of the test bed."""
    if request.param == "testbed":
        ports = [free_port() for _ in range(4)]
        start("fss_sim.testbed_node", "--ros-args", "-p", f"ports:={ports}", "-p", f"keys:={keys}")
        yield f"udp://127.0.0.1:{ports[0]}?bind={free_port()}"
        return
    command = [build("fss_link"), "--link", "1", *request.param.split(), "--keys", str(keys)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as link:
        told = link.stdout.readline()  # "link 1 at udp 40001, signed"
        place = told.split()[4].rstrip(",")
        forms = {
            "udp": f"udp://127.0.0.1:{place}?bind={free_port()}",
            "tcp": f"tcp://127.0.0.1:{place}",
            "serial": f"serial://{place}",
        }
        yield forms[told.split()[3]]
        link.kill()


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


@pytest.mark.parametrize(
    "url",
    ["--udp 0", "--tcp 0", "--pty", "testbed"],
    indirect=True,
)
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


@pytest.mark.parametrize(
    ("url", "step"),
    [("--udp 0", -3600.0), ("--tcp 0", 3600.0), ("--pty", -3600.0)],
    indirect=["url"],
)
def test_a_driver_that_starts_again_with_another_time_has_its_link_in_5_s(spin, url, keys, step):
    parameters = [Parameter("keys", value=str(keys))]
    first, person = LinkNode(1, url, parameter_overrides=parameters), TurnPerson()
    begin(spin, [first, person], person)
    first.close()
    person.joint = None
    clock = HostClock(day=lambda: time.time_ns() + round(step * 1e9))
    second = LinkNode(1, url, clock=clock, parameter_overrides=parameters)
    spin([second, person], lambda: not second.session.obstacle(second.now()), 5.0)
    second.session.arm(second.now())
    spin([second, person], lambda: second.session.armed)


@pytest.mark.parametrize("url", ["--udp 0"], indirect=True)
def test_two_drivers_of_a_link_do_not_share_it_and_both_say_so(spin, start, url, keys):
    first, person = start(*arguments(url, keys)), TurnPerson()
    begin(spin, [person], person)
    other = f"{url.partition('=')[0]}={free_port()}"
    start(*arguments(other, keys), "-r", "__ns:=/other")
    arming = person.create_client(SetBool, "/other/link_1/arm")
    lost = (
        "link_1 is lost: nothing received yet: is it switched on, and does no other driver use it?"
    )

    def told():
        assert person.turning()
        said = {place: status.message for place, status in person.health.items()}
        return "does a second driver run?" in said.get(url, "") and said.get(other) == lost

    spin(person, told, 30.0)
    assert person.health[url].level == DiagnosticStatus.WARN
    assert person.health[other].level == DiagnosticStatus.ERROR
    spin(person, arming.service_is_ready)
    refused = arming.call_async(SetBool.Request(data=True))
    spin(person, refused.done)
    assert not refused.result().success
    assert "no other driver" in refused.result().message
    assert person.turning()
    assert first.output.count("does a second driver run?") == 1
    first.stop(signal.SIGKILL)
    spin(person, lambda: person.health[other].message.startswith("link_1 is disarmed"))
    armed = arming.call_async(SetBool.Request(data=True))
    spin(person, armed.done)
    assert armed.result().success
