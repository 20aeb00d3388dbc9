"""Frames over UDP, TCP and a pseudo-terminal: one suite for all, then what is each one's own."""

import errno
import os
import resource
import socket
import termios
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

import pytest
from driver_wire import ENDS, TIMEOUT, go_in_mid_open
from running import wait_until

from fss_arm_driver.transport import COPLEY_FORM, open_transport
from fss_link.transport import BATCH, SCHEMES, TransportError, UdpTransport, stream
from fss_link.transport.udp import BUFFER_PER_FRAME, BUFFERED_FRAMES

DOWN, UP = bytes(range(72)), bytes(range(72, 144))

#: Form of a URL, by its scheme.
FORMS = {**{name: one.form for name, one in SCHEMES.items()}, "copley": COPLEY_FORM}


@pytest.fixture
def crowd():
    """More open files than `select` supports."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    files = [os.open(os.devnull, os.O_RDONLY) for _ in range(1024)]
    yield
    for file in files:
        os.close(file)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture(params=ENDS)
def end(request, tmp_path):
    """The far end, over which nothing is open yet."""
    end = ENDS[request.param](tmp_path)
    yield end
    end.close()


@pytest.fixture
def opened():
    """opened(url): a transport, closed after the test."""
    transports = []

    def open_one(url):
        transports.append(open_transport(url))
        return transports[-1]

    yield open_one
    for transport in transports:
        transport.close()


@pytest.fixture
def joined(end, opened):
    """Both ends of a transport over which a frame has gone."""
    transport = opened(end.url)
    meet(transport, end)
    return transport, end


def meet(transport, end):
    """Send until the other end hears."""

    def heard():
        transport.wait(0.01)
        transport.receive()  # what an executor does when it is woken
        transport.send(DOWN)
        return end.receive(0.02) == DOWN

    wait_until(heard, TIMEOUT, lambda: None)
    while end.receive(0.0):
        pass


def test_any_number_of_files_may_be_open(crowd, end, opened):
    transport = opened(end.url)
    meet(transport, end)
    end.send(UP)
    assert transport.wait(TIMEOUT)
    assert transport.receive() == [UP]


def receive_frames(transport):
    """The next frames that come."""
    return wait_until(transport.receive, TIMEOUT, lambda: transport.wait(0.1))


def test_both_ways(joined):
    transport, end = joined
    assert transport.problem == ""
    end.send(UP)
    assert receive_frames(transport) == [UP]
    assert transport.receive() == []
    assert not transport.wait(0.0)
    transport.send(DOWN)
    assert end.receive() == DOWN


def test_the_far_end_may_go_and_come_back(joined):
    transport, end = joined
    for _ in range(2):
        end.unplug()
        for _ in range(3):
            transport.send(b"nobody there")
            transport.wait(0.01)
            transport.receive()
        end.replug()
        meet(transport, end)
        end.send(UP)
        assert UP in receive_frames(transport)
        assert transport.problem == ""


def test_a_flood_is_read_in_batches(joined):
    transport, end = joined
    for _ in range(2 * BATCH):
        end.send(UP)
    got = receive_frames(transport)
    assert len(got) < 2 * BATCH
    while len(got) < 2 * BATCH:
        got += receive_frames(transport)
    assert got == [UP] * 2 * BATCH


@pytest.mark.slow
def test_a_thousand_restarts_leak_nothing(joined):
    """Frames of a link's electronics, and of its driver."""
    transport, end = joined
    before = descriptors()
    for _ in range(1000):
        end.unplug()
        transport.send(DOWN)
        transport.wait(0.0)
        end.replug()
        meet(transport, end)
    assert descriptors() == before
    for _ in range(1000):
        transport.close()
        transport = open_transport(end.url)
        transport.wait(0.0)
        end.accept()
    transport.close()
    assert descriptors() <= before


def descriptors():
    return len(os.listdir("/proc/self/fd"))


def test_a_closed_transport_does_nothing(joined):
    transport, _ = joined
    transport.close()
    transport.send(DOWN)
    assert transport.receive() == []


@pytest.mark.parametrize("end", ["tcp", "pty"], indirect=True)
def test_bytes_that_are_no_frames_are_said(joined):
    transport, end = joined

    def noise():
        end.raw(b"\xf8\x00\x78" * 50)
        transport.wait(0.1)
        assert transport.receive() == []

    wait_until(lambda: transport.problem, TIMEOUT, noise)
    assert "the received bytes are no frames: is " in transport.problem
    assert transport.counts["noise_bytes"] > 1000
    end.send(UP)
    assert receive_frames(transport) == [UP]
    assert transport.problem == ""


@pytest.mark.parametrize("end", ["tcp", "pty"], indirect=True)
def test_an_end_that_does_not_read_holds_nothing_up(joined):
    transport, end = joined
    for _ in range(100_000):
        transport.send(DOWN)
        if transport.counts["send_failures"] > 10:
            break
    assert transport.counts["send_failures"] > 10
    end.send(UP)
    assert UP in receive_frames(transport)


@pytest.mark.parametrize("end", ["tcp", "pty"], indirect=True)
def test_a_lost_connection_is_said(joined):
    transport, end = joined
    end.unplug()
    problems = []

    def poll():
        transport.wait(0.01)
        transport.receive()
        problems.append(transport.problem or "connection lost")

    wait_until(lambda: transport.problem.startswith("cannot connect: "), TIMEOUT, poll)
    assert all(words.startswith(("connection lost", "cannot connect: ")) for words in problems)


def test_a_stream_is_not_closed_while_a_frame_is_written_to_it(opened, monkeypatch):
    """Its file descriptor might be another file's by then."""
    end = ENDS["tcp"](None)
    transport = opened(end.url)
    meet(transport, end)
    line, writing, go_on = transport._line, Event(), Event()

    def write(number, data):
        writing.set()
        assert go_on.wait(TIMEOUT)
        return os.write(number, data)

    monkeypatch.setattr(stream, "os", SimpleNamespace(write=write, read=os.read))
    sender = Thread(target=transport.send, args=(DOWN,))
    sender.start()
    assert writing.wait(TIMEOUT)
    transport._break(ConnectionResetError())
    waiter = Thread(target=transport.wait, args=(0.0,))
    waiter.start()
    waiter.join(0.2)
    assert line.fileno() >= 0
    go_on.set()
    sender.join()
    waiter.join()
    assert line.fileno() == -1
    end.close()


@pytest.fixture
def udp(opened):
    end = ENDS["udp"](None)
    yield opened(end.url), end
    end.close()


def test_two_seconds_of_frames_wait_while_nobody_reads(udp):
    """Or as many as the system has room for, whose own default is a quarter of that."""
    transport, end = udp
    meet(transport, end)
    with open("/proc/sys/net/core/rmem_max") as file:
        room = 2 * int(file.read()) // BUFFER_PER_FRAME
    for _ in range(BUFFERED_FRAMES):
        end.send(UP)
    got = []
    while transport.wait(0.1):
        got += transport.receive()
    assert len(got) >= 0.9 * min(BUFFERED_FRAMES, room)


def test_strangers_are_counted_and_not_heard(udp):
    transport, _ = udp
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"hello", ("127.0.0.1", transport.port))
    assert transport.wait(5.0)
    assert transport.receive() == []
    assert transport.counts["other_senders"] == 1


def test_long_datagrams_are_cut(udp):
    transport, end = udp
    end.home = "127.0.0.1", transport.port
    end.send(bytes(1000))
    assert [len(data) for data in receive_frames(transport)] == [73]


def test_what_cannot_be_sent_is_counted_and_said(udp):
    transport, _ = udp
    transport.send(bytes(100_000))
    assert transport.counts["send_failures"] == 1
    assert transport.problem == "cannot send: Message too long"
    transport.send(DOWN)
    assert transport.problem == ""


NO_URLS = [
    "udp://127.0.0.1", "udp://127.0.0.1:0", "udp://127.0.0.1:70000", "udp://:5001",
    "udp://127.0.0.1:5001?bind=x", "udp://127.0.0.1:5001?bind=70000",
    "udp://127.0.0.1:5001?bnd=6001", "udp://127.0.0.1:5001/path", "tcp://127.0.0.1",
    "tcp://127.0.0.1:5001?bind=6001", "serial://", "serial:///dev/null?baud=fast",
    "serial:///dev/null?baud=0", "serial:///dev/null?rate=9600",
]  # fmt: skip


@pytest.mark.parametrize("url", NO_URLS)
def test_urls_that_name_no_transport_are_refused(url):
    with pytest.raises(TransportError) as error:
        open_transport(url)
    form = FORMS[url.partition(":")[0]]
    assert f"url is {url!r}, expected {form}: " in str(error.value)


@pytest.mark.parametrize("url", ["", "127.0.0.1:5001", "http://127.0.0.1:5001"])
def test_all_forms_are_told_to_who_knows_none(url):
    with pytest.raises(TransportError) as error:
        open_transport(url)
    assert all(form in str(error.value) for form in FORMS.values())


def test_a_taken_port_is_named(udp):
    transport, _ = udp
    with pytest.raises(
        TransportError,
        match=rf"bind={transport.port}' cannot be opened: Address .*; another driver of this link",
    ):
        open_transport(f"udp://127.0.0.1:9?bind={transport.port}")


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("no_such_port", "No such file or directory"),
        ("null", "it is no serial port, or does not support 9600 baud"),
    ],
)
def test_a_dead_serial_port_is_named(device, words):
    url = f"serial://{device}?baud=9600"
    with pytest.raises(TransportError) as error:
        open_transport(url)
    assert str(error.value) == f"url {url!r} cannot be opened: {words}"


@pytest.mark.parametrize(
    ("group", "words"),
    [
        ("dialout", "Permission denied: run sudo usermod -aG dialout $USER, then log in again"),
        ("root", "Permission denied"),
    ],
)
def test_a_serial_port_without_permission_is_named_with_the_remedy(monkeypatch, group, words):
    def refused(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "group", lambda _: group)
    monkeypatch.setattr("serial.serialposix.os.open", refused)
    with pytest.raises(TransportError) as error:
        open_transport("serial:///dev/ttyUSB0")
    assert str(error.value) == f"url 'serial:///dev/ttyUSB0' cannot be opened: {words}"


@pytest.mark.parametrize("end", ["pty"], indirect=True)
def test_a_serial_port_is_for_one_process(joined):
    _, end = joined
    with pytest.raises(TransportError, match="another process has it open"):
        open_transport(end.url)
    assert os.path.exists(end.device)


def test_localhost_is_the_ipv4_one_if_there_are_two():
    transport = UdpTransport("localhost", 9)
    assert transport._socket.family == socket.AF_INET
    transport.close()


def test_an_adapter_that_goes_while_it_is_set_up_is_found_again(opened, tmp_path, monkeypatch):
    end = ENDS["pty"](tmp_path)
    transport = opened(end.url)
    meet(transport, end)
    end.unplug()
    while not transport.problem:
        transport.wait(0.01)
        transport.receive()
    end.replug()
    with monkeypatch.context() as patch:
        patch.setattr(termios, "tcsetattr", go_in_mid_open)
        assert not transport.wait(0.01)
        assert transport.problem == "cannot connect: Input/output error"
        with pytest.raises(TransportError, match="Input/output error"):
            open_transport(end.url)
    meet(transport, end)
    assert transport.problem == ""
    end.close()
