"""The gate lets in who asks this computer by its address or name, and shuts the page in."""

import asyncio
import json
import os
import time
from pathlib import Path

import pytest

from fss_arm_view import gate
from fss_arm_view.page import NOW

NAMES = {"localhost", "fss", "fss.local"}
PAGE = (
    b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 104\r\n"
    b'Connection: keep-alive\r\n\r\n<html><link rel="preconnect" href="https://fonts.example" />'
    b'<link rel="icon" href="favicon.ico">'
)


@pytest.mark.parametrize(
    "host",
    ["localhost", "LOCALHOST:9090", "127.0.0.1:9090", "192.168.1.5", "[::1]:9090", "fss.local"],
)
def test_addresses_and_own_names_are_let_in(host):
    assert gate.is_own(host, NAMES)


@pytest.mark.parametrize(
    "host",
    ["", "evil.example", "evil.example:9090", "localhost.evil.example", "127.0.0.1.evil.example",
     "fss@evil.example", "[::1", "a b", "evil.example#localhost", "::1"],
)  # fmt: skip
def test_other_names_are_not(host):
    assert not gate.is_own(host, NAMES)


def test_two_hosts_are_none():
    head = b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"
    assert gate.header(head, b"host") == ""


async def ask(port, said):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(said)
    answer = await asyncio.wait_for(reader.read(), 5.0)
    writer.close()
    return answer


def through(said, which, page=PAGE, file=Path("none")):
    """What comes back through the gate, and what got to rerun's port; which: 0 data, 1 page."""
    got = []

    async def rerun(reader, writer):
        got.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(page)
        writer.close()

    async def run():
        inner = [await asyncio.start_server(rerun, "127.0.0.1", 0) for _ in range(2)]
        within = [server.sockets[0].getsockname()[1] for server in inner]
        ports = []
        for _ in range(2):
            probe = await asyncio.start_server(rerun, "127.0.0.1", 0)
            ports.append(probe.sockets[0].getsockname()[1])
            probe.close()
            await probe.wait_closed()
        task = asyncio.create_task(
            gate.guard("127.0.0.1", tuple(ports), tuple(within), file, "fss")
        )
        for _ in range(100):
            try:
                return await ask(ports[which], said), ports
            except ConnectionRefusedError:
                await asyncio.sleep(0.02)
            finally:
                task.cancel() if got or task.done() else None
        raise TimeoutError

    answer, ports = asyncio.run(run())
    return answer, got, ports


def test_the_page_comes_with_a_policy():
    answer, got, ports = through(b"GET /x HTTP/1.1\r\nHost: fss:9090\r\nConnection: x\r\n\r\n", 1)
    assert got == [b"GET /x HTTP/1.1\r\nHost: fss:9090\r\nConnection: close\r\n\r\n"]
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body == b'<html><link rel="icon" href="favicon.ico">'
    assert gate.header(head, b"content-length") == str(len(body))
    policy = gate.header(head + b"\r\n\r\n", b"content-security-policy")
    assert "default-src 'self'" in policy
    assert f"connect-src 'self' http://fss:{ports[0]};" in policy
    assert gate.header(head, b"connection") == "close"


@pytest.mark.parametrize("which", [0, 1])
def test_a_name_from_elsewhere_gets_nothing(which):
    answer, got, _ = through(b"GET / HTTP/1.1\r\nHost: evil.example:9090\r\n\r\n", which)
    assert answer.startswith(b"HTTP/1.1 403 ")
    assert b"-p names:=[NAME]" in answer
    assert not got


@pytest.mark.parametrize("said", [gate.HTTP2 + b"\r\n", b"POST / HTTP/1.1\r\nHost: [::1]\r\n\r\n"])
def test_data_pass_as_they_are(said):
    answer, got, _ = through(said, 0)
    assert got == [said]
    assert answer == PAGE


def test_the_page_has_the_strip_above_it():
    page = PAGE.replace(b'favicon.ico">', b'favicon.ico"><body></body></html>')
    answer, _, _ = through(b"GET / HTTP/1.1\r\nHost: fss:9090\r\n\r\n", 1, page)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body.index(b'<div id="fss_age"') < body.index(b"</body>")
    assert gate.header(head, b"content-length") == str(len(body))


def test_what_the_strip_shows_comes_with_its_age(tmp_path):
    """So that a node that is gone, or stands still, does not look alive."""
    ask_now = f"GET {NOW} HTTP/1.1\r\nHost: fss:9090\r\n\r\n".encode()
    assert through(ask_now, 1, file=tmp_path / "none")[0].startswith(b"HTTP/1.1 503 ")
    file = tmp_path / "now.json"
    file.write_text('{"newest": "1"}')
    os.utime(file, (time.time() - 60.0,) * 2)
    answer, got, _ = through(ask_now, 1, file=file)
    said = json.loads(answer.partition(b"\r\n\r\n")[2])
    assert said["said"] == {"newest": "1"}
    assert 59.0 < said["age"] < 70.0
    assert not got
