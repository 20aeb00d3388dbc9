"""The gate accepts requests to this computer's addresses and names, and serves the live page."""

import asyncio
import socket
from unittest.mock import Mock

import pytest

from fss_arm_view import gate
from fss_arm_view.page import EVENTS, HISTORY

NAMES = {"localhost", "fss", "fss.local"}
PAGE = (
    b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 104\r\n"
    b'Connection: keep-alive\r\n\r\n<html><link rel="preconnect" href="https://fonts.example" />'
    b'<link rel="icon" href="favicon.ico">'
)


OWN = (
    *("localhost", "LOCALHOST:9090", "127.0.0.1:9090", "192.168.1.5", "[::1]:9090", "fss.local"),
    *("127.0.0.1:65535", "[fe80::1%eth0]:9090"),
)
OTHERS = (
    *("", "evil.example", "evil.example:9090", "localhost.evil.example", "fss@evil.example"),
    *("127.0.0.1.evil.example", "[::1", "a b", "evil.example#localhost", "::1", "[127.0.0.1]"),
    *("127.0.0.1:9090.evil", "localhost:9090.evil", "127.0.0.1:", "127.0.0.1:0", "127.1", "0"),
    *("127.0.0.1:65536", "127.0.0.1:+1", "127.0.0.1:9090/evil", "fss@127.0.0.1", "[::1]evil"),
    *("[::1]:9090:1", "0.0.0.0", "0.0.0.0:9090", "[::]:9090", "[::ffff:0.0.0.0]:9090"),
)


def test_addresses_and_own_names_are_accepted():
    assert [host for host in OWN if not gate.is_own_host(host, NAMES)] == []


def test_other_names_are_rejected():
    assert [host for host in OTHERS if gate.is_own_host(host, NAMES)] == []


def test_two_host_headers_are_rejected():
    head = b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"
    assert gate.header_value(head, b"host") == ""


async def ask(port, request, until=b""):
    """Return the answer, complete or up to and including `until`."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    answer = await asyncio.wait_for(reader.readuntil(until) if until else reader.read(), 5.0)
    writer.close()
    return answer


def send_through(request, which, page=PAGE, states=(), until=b""):
    """Return the answer, the data that reached rerun, and the ports; which: 0 data, 1 page."""
    received = []

    async def rerun(reader, writer):
        received.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(page)
        writer.close()

    async def run():
        inner = [await asyncio.start_server(rerun, "127.0.0.1", 0) for _ in range(2)]
        within = tuple(server.sockets[0].getsockname()[1] for server in inner)
        listening = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
        ports = [port.getsockname()[1] for port in listening]
        node, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for state in states:
            node.send(state)
        task = asyncio.create_task(gate.serve_gate(tuple(listening), end, within, "fss"))
        answer = await ask(ports[which], request, until)
        node.close()
        await asyncio.wait_for(task, 5.0)
        return answer, ports

    answer, ports = asyncio.run(run())
    return answer, received, ports


def get(path, *headers, **options):
    """Return head and body of a page, the data that reached rerun, and the ports."""
    lines = f"GET {path} HTTP/1.1", "Host: fss:9090", *headers, "\r\n"
    answer, received, ports = send_through("\r\n".join(lines).encode(), 1, **options)
    head, end, body = answer.partition(b"\r\n\r\n")
    return head + end, body, received, ports


def test_the_page_of_rerun_has_a_policy():
    head, body, received, ports = get("/rerun/x", "Connection: x")
    assert received == [b"GET /x HTTP/1.1\r\nHost: fss:9090\r\nConnection: close\r\n\r\n"]
    assert body == b'<html><link rel="icon" href="favicon.ico">'
    assert gate.header_value(head, b"content-length") == str(len(body))
    policy = gate.header_value(head, b"content-security-policy")
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


def test_rerun_s_page_has_a_line_about_its_lag():
    page = PAGE.replace(b'favicon.ico">', b'favicon.ico"><body></body></html>')
    head, _, _, ports = get("/rerun")
    address = f"{HISTORY}/?url=rerun%2Bhttp://fss:{ports[0]}/proxy"
    assert gate.header_value(head, b"location") == address
    head, body, received, _ = get(address, page=page)
    assert received[0].startswith(b"GET /?url=rerun")
    assert body.index(b"may lag") < body.index(b"</body>")
    assert gate.header_value(head, b"content-length") == str(len(body))


@pytest.mark.parametrize("path", ["/", "/page.css", "/page.js", "/drawing.js"])
def test_the_live_page_needs_neither_rerun_nor_inline_scripts(path):
    head, body, received, _ = get(path)
    assert head.startswith(b"HTTP/1.1 200 ")
    assert gate.header_value(head, b"content-length") == str(len(body))
    policy = gate.header_value(head, b"content-security-policy")
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert b"://" not in body  # no other host
    assert not received


def test_what_is_not_there_is_not_found():
    assert get("/x")[0].startswith(b"HTTP/1.1 404 ")
    assert send_through(b"x\r\n\r\n", 1)[0].startswith(b"HTTP/1.1 403 ")


def test_a_page_receives_the_last_minute_and_then_the_present():
    states = [b"%d" % k for k in range(100)]
    head, body, *_ = get(EVENTS, states=states, until=b"data: 99\n\n")
    assert b"text/event-stream" in head
    assert body.endswith(b"data: 98\n\ndata: 99\n\n")


def test_a_slow_client_skips_states():
    async def run():
        feed, written, released = gate.Feed(), [], asyncio.Event()
        client = Mock(write=written.append, drain=released.wait)  # accepts nothing until released
        feed.add(b"0")
        task = asyncio.create_task(feed.send(client))
        await asyncio.sleep(0)
        for k in range(1, 100):
            feed.add(b"%d" % k)
            await asyncio.sleep(0)
        released.set()
        while len(written) < 2:
            await asyncio.sleep(0)
        task.cancel()
        return written

    first, second = asyncio.run(run())
    assert first.endswith(b"data: 0\n\n")
    assert second == b"data: 99\n\n"
