"""The gate accepts requests to this computer's addresses and names, and restricts the page."""

import asyncio
import json
import os
import time
from pathlib import Path

import pytest

from fss_arm_view import gate
from fss_arm_view.page import STATUS_PATH

NAMES = {"localhost", "fss", "fss.local"}
PAGE = (
    b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 104\r\n"
    b'Connection: keep-alive\r\n\r\n<html><link rel="preconnect" href="https://fonts.example" />'
    b'<link rel="icon" href="favicon.ico">'
)


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST:9090",
        "127.0.0.1:9090",
        "192.168.1.5",
        "[::1]:9090",
        "fss.local",
        "127.0.0.1:65535",
        "[fe80::1%eth0]:9090",
    ],
)
def test_addresses_and_own_names_are_accepted(host):
    assert gate.is_own_host(host, NAMES)


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "evil.example:9090",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "fss@evil.example",
        "[::1",
        "a b",
        "evil.example#localhost",
        "::1",
        "[127.0.0.1]",
        "127.0.0.1:9090.evil",
        "localhost:9090.evil",
        "127.0.0.1:",
        "127.0.0.1:0",
        "127.0.0.1:65536",
        "127.0.0.1:+1",
        "127.0.0.1:9090/evil",
        "fss@127.0.0.1",
        "[::1]evil",
        "[::1]:9090:1",
        "0.0.0.0",
        "0.0.0.0:9090",
        "[::]:9090",
        "[::ffff:0.0.0.0]:9090",
        "127.1",
        "0",
    ],
)
def test_other_names_are_rejected(host):
    assert not gate.is_own_host(host, NAMES)


def test_two_host_headers_are_rejected():
    head = b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"
    assert gate.header_value(head, b"host") == ""


async def ask(port, request):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    answer = await asyncio.wait_for(reader.read(), 5.0)
    writer.close()
    return answer


def send_through(request, which, page=PAGE, file=Path("none")):
    """Return the answer, the data that reached rerun, and the ports; which: 0 data, 1 page."""
    received = []

    async def rerun(reader, writer):
        received.append(await reader.readuntil(b"\r\n\r\n"))
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
            gate.serve_gate("127.0.0.1", tuple(ports), tuple(within), file, "fss")
        )
        for _ in range(100):
            try:
                return await ask(ports[which], request), ports
            except ConnectionRefusedError:
                await asyncio.sleep(0.02)
            finally:
                task.cancel() if received or task.done() else None
        raise TimeoutError

    answer, ports = asyncio.run(run())
    return answer, received, ports


def test_the_page_has_a_policy():
    answer, received, ports = send_through(
        b"GET /x HTTP/1.1\r\nHost: fss:9090\r\nConnection: x\r\n\r\n", 1
    )
    assert received == [b"GET /x HTTP/1.1\r\nHost: fss:9090\r\nConnection: close\r\n\r\n"]
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body == b'<html><link rel="icon" href="favicon.ico">'
    assert gate.header_value(head, b"content-length") == str(len(body))
    policy = gate.header_value(head + b"\r\n\r\n", b"content-security-policy")
    assert "default-src 'self'" in policy
    assert f"connect-src 'self' http://fss:{ports[0]};" in policy
    assert gate.header_value(head, b"connection") == "close"


@pytest.mark.parametrize("which", [0, 1])
def test_a_foreign_name_is_rejected(which):
    answer, received, _ = send_through(b"GET / HTTP/1.1\r\nHost: evil.example:9090\r\n\r\n", which)
    assert answer.startswith(b"HTTP/1.1 403 ")
    assert b"-p names:=[NAME]" in answer
    assert not received


@pytest.mark.parametrize(
    "request_bytes", [gate.HTTP2 + b"\r\n", b"POST / HTTP/1.1\r\nHost: [::1]\r\n\r\n"]
)
def test_data_pass_unchanged(request_bytes):
    answer, received, _ = send_through(request_bytes, 0)
    assert received == [request_bytes]
    assert answer == PAGE


def test_the_page_contains_the_strip():
    page = PAGE.replace(b'favicon.ico">', b'favicon.ico"><body></body></html>')
    answer, _, _ = send_through(b"GET / HTTP/1.1\r\nHost: fss:9090\r\n\r\n", 1, page)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body.index(b'<div id="fss_age"') < body.index(b"</body>")
    assert gate.header_value(head, b"content-length") == str(len(body))


def test_the_content_of_the_strip_has_its_age(tmp_path):
    """A node that has stopped or stalls must not look alive."""
    ask_now = f"GET {STATUS_PATH} HTTP/1.1\r\nHost: fss:9090\r\n\r\n".encode()
    assert send_through(ask_now, 1, file=tmp_path / "none")[0].startswith(b"HTTP/1.1 503 ")
    file = tmp_path / "now.json"
    file.write_text('{"newest": "1"}')
    os.utime(file, (time.time() - 60.0,) * 2)
    answer, received, _ = send_through(ask_now, 1, file=file)
    status = json.loads(answer.partition(b"\r\n\r\n")[2])
    assert status["status"] == {"newest": "1"}
    assert 59.0 < status["age"] < 70.0
    assert not received
