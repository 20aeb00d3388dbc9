"""The base's node and its board's own code: valves of a computer that dies close by themselves."""

import shutil
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from base_bench import User
from base_firmware import Emulation
from firmware import BASE, firmware_url
from running import free_port
from std_srvs.srv import SetBool

from fss_arm_driver.transport import open_transport
from fss_base_driver import protocol
from fss_base_driver.protocol import BaseSlow, BaseState

KEY = bytes(range(16))
MS = 1000


@pytest.fixture
def keys(keys_file) -> Path:
    return keys_file({0: KEY})


slow = partial(pytest.param, marks=pytest.mark.slow)


@pytest.fixture(params=["--udp 0", *map(slow, ("--tcp 0", "--pty", "emulated"))])
def url(request, keys) -> Iterator[str]:
    """Where the firmware is: a process, or on an emulated board."""
    if request.param == "emulated":
        if not (shutil.which("arm-none-eabi-g++") and shutil.which("qemu-system-arm")):
            pytest.skip("arm-none-eabi-g++ or qemu-system-arm is not installed")
        board = Emulation(KEY)
        yield f"udp://127.0.0.1:{board.port}?bind={free_port()}"
        board.close()
        return
    with firmware_url(BASE, request.param, keys) as url:
        yield url


def test_valves_of_a_driver_killed_in_mid_pulse_close_within_the_watchdog(spin, start, url, keys):
    driver = start(
        "fss_base_driver.base_node", "--ros-args", "-p", f"url:={url}", "-p", f"keys:={keys}"
    )
    person = User()
    spin(person, lambda: person.telemetry and person.arm.service_is_ready(), 30.0)
    spin(person, person.thrust.get_subscription_count)
    armed = person.arm.call_async(SetBool.Request(data=True))
    assert spin(person, armed.done, 20.0)
    assert armed.result().success, armed.result().message
    person.open(*8 * [1.0])
    spin(person, lambda: person.telemetry[-1].valves == 255)
    driver.stop(signal.SIGKILL)

    transport = open_transport(url)
    frames: list[protocol.BaseTelemetry] = []

    def listen() -> bool:
        transport.wait(0.1)
        frames.extend(protocol.decode(data, KEY) for data in transport.receive())
        slow = {frame.slow_id for frame in frames if frame.flags & BaseState.WATCHDOG}
        return slow >= set(range(BaseSlow.OPEN_1, BaseSlow.OPEN_8 + 1))

    spin(person, listen, 20.0)
    transport.close()
    tripped = [frame for frame in frames if frame.flags & BaseState.WATCHDOG]
    before = [frame for frame in frames if not frame.flags & BaseState.WATCHDOG]
    opened = [frame.slow_value for frame in tripped if frame.slow_id >= BaseSlow.OPEN_1]
    into = tripped[0].pulse_age / 10 - tripped[0].turnaround / MS
    print(f"last command {into:.0f} ms into the pulse; open for {max(opened)} of 1000 ms")
    assert all(frame.turnaround <= 500 * MS for frame in before)
    assert all(frame.valves == 255 for frame in before)  # none if this computer listens too late
    assert not any(frame.valves for frame in tripped)
    assert not tripped[0].flags & BaseState.ARMED
    assert max(opened) - min(opened) == 0
    # From the pulse's begin to the last command, and the watchdog time: not a millisecond more.
    assert max(opened) == pytest.approx(into + 500, abs=1.1)
    assert max(opened) < 1000
