"""Gate: serves the live page, and relays requests to rerun; no request leaves the laboratory.

The node passes a state ten times a second through a socket (`live.py`). A page receives those of
the last minute, then each new one, as server-sent events. A page that is too slow skips states, so
that what it draws is never late.

rerun's program serves every client, under any host name. Its page requests fonts and releases from
hosts of rerun's vendor, and reports to them how it is used. The gate is a proxy for both servers:

- A request is accepted if its Host is an address or a name of this computer, so that a foreign
  page cannot reach the servers under its own host name (DNS rebinding). Clients that speak HTTP/2
  from the first line have no Host to check. rerun's own programs do so, but no browser does.
- Pages are sent with a policy by which browsers load from this host only. Links that would make
  browsers look up other hosts before they apply the policy are removed.

It imports only modules that load quickly, and runs as a separate process:
`python -m fss_arm_view.gate`.
"""

import asyncio
import re
import socket
import sys
from asyncio import StreamReader, StreamWriter
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable
from contextlib import asynccontextmanager, suppress
from functools import partial
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from fss_arm_view.page import EVENTS, HISTORY, page_file, with_note

HTTP2 = b"PRI * HTTP/2.0\r\n"
HOST = re.compile(r"(?P<name>\[[\w.:%-]+\]|[\w.-]+)(:(?P<port>\d{1,5}))?", re.ASCII)
HEAD_TIMEOUT = 10.0  # for the head of a request [s]
UNKNOWN_HOST = (
    "unknown host name: open the page by an address or a name of this computer,\n"
    "or start the view with -p names:=[NAME] to allow another name\n"
)
MAX_STATE = 1 << 18  # size of a state [bytes]
STATES = 600  # kept for new clients: one minute
SEND_BUFFER = 1 << 15  # of a client's connection [bytes]: few states wait in it
PAGE_POLICY = "default-src 'self'; img-src 'self' data:; form-action 'none'; frame-ancestors 'self'"
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:; "
    "connect-src 'self' {data}; form-action 'none'; frame-ancestors 'self'"
)


def is_own_host(host: str, host_names: Iterable[str]) -> bool:
    """Return True if a Host header, with or without port, is an IP address or in `host_names`.

    An unspecified address such as 0.0.0.0 is no address of this computer, although browsers connect
    to this computer by it: pages of other sites have used it to reach local servers.
    """
    found = HOST.fullmatch(host.strip())
    if not found or not 0 < int(found["port"] or 80) < 1 << 16:
        return False
    name = found["name"].lower().strip("[]")
    try:
        address = ip_address(name)
    except ValueError:
        return name in host_names
    mapped = getattr(address, "ipv4_mapped", None) or address
    return not mapped.is_unspecified and (address.version == 6) == found["name"].startswith("[")


def header_value(head: bytes, name: bytes) -> str:
    """Return a header's value from the head of a message; empty if it is absent or repeated."""
    found = [
        line.partition(b":")[2].decode("latin-1").strip()
        for line in head.split(b"\r\n")[1:]
        if line.partition(b":")[0].lower() == name
    ]
    return found[0] if len(found) == 1 else ""


def remove_header(head: bytes, name: bytes) -> bytes:
    """Return the head of a message without a header, and without its final empty line."""
    lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    return b"\r\n".join(line for line in lines if line.partition(b":")[0].lower() != name)


def remove_foreign_links(page: bytes) -> bytes:
    """Return the page without links to other hosts."""
    return re.sub(rb"<link\b[^>]*\bhref=.https?://[^>]*>", b"", page)


async def _relay(reader: StreamReader, writer: StreamWriter) -> None:
    with suppress(OSError):
        while chunk := await reader.read(1 << 16):
            writer.write(chunk)
            await writer.drain()
        writer.write_eof()


def response(status: str, body: bytes = b"", **headers: str) -> bytes:
    """Return an HTTP response; headers are written with underscores."""
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", "Connection: close"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return "\r\n".join([*lines, "\r\n"]).encode() + body


class Feed:
    """States of the node for the pages: those of the last minute, and the newest as it arrives."""

    def __init__(self) -> None:
        self.states: deque[bytes] = deque(maxlen=STATES)
        self.count = 0  # states received
        self.arrived = asyncio.Event()  # replaced after each state

    def add(self, state: bytes) -> None:
        """Add a state, and wake the clients that wait for it."""
        self.states.append(b"data: %s\n\n" % state)
        self.count += 1
        self.arrived.set()
        self.arrived = asyncio.Event()

    async def receive(self, source: socket.socket) -> None:
        """Receive states until the node closes its end of the socket."""
        source.setblocking(False)
        while state := await asyncio.get_running_loop().sock_recv(source, MAX_STATE):
            self.add(state)

    async def send(self, writer: StreamWriter) -> None:
        """Send states to a client until it leaves; skip those that it is too slow for."""
        connection = writer.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        writer.transport.set_write_buffer_limits(0)  # so that `drain` waits for the connection
        writer.write(
            b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n"
            b"Connection: close\r\n\r\n" + b"".join(self.states)
        )
        while True:
            sent = self.count
            await writer.drain()
            if sent == self.count:
                await self.arrived.wait()
            writer.write(self.states[-1])


async def _serve_page(head: bytes, client: Any, port: int, data_port: int, feed: Feed) -> None:
    """Serve one request: for the live page, its states, or rerun's page below HISTORY."""
    path = head.split(b" ", 2)[1].decode("latin-1")
    name = urlsplit(f"//{header_value(head, b'host')}").hostname or ""
    data = f"{f'[{name}]' if ':' in name else name}:{data_port}"
    if path == EVENTS:
        await feed.send(client[1])
    elif file := page_file(path):
        kind, body = file
        headers = {"Content_Security_Policy": PAGE_POLICY, "X_Content_Type_Options": "nosniff"}
        client[1].write(response("200 OK", body, Content_Type=kind, **headers))
    elif path == HISTORY:
        location = f"{HISTORY}/?url=rerun%2Bhttp://{data}/proxy"
        client[1].write(response("302 Found", Location=location))
    elif path.startswith(f"{HISTORY}/"):
        await _relay_history(head.replace(f"{HISTORY}/".encode(), b"/", 1), client, port, data)
    else:
        client[1].write(response("404 Not Found"))
    await client[1].drain()


async def _relay_history(head: bytes, client: Any, port: int, data: str) -> None:
    """Relay one request for rerun's page, with the policy among the response's headers."""
    async with _connection(port) as server:
        server[1].write(remove_header(head, b"connection") + b"\r\nConnection: close\r\n\r\n")
        answer = await server[0].readuntil(b"\r\n\r\n")
        policy = POLICY.format(data=f"http://{data}").encode()
        added = b"\r\nConnection: close\r\nX-Content-Type-Options: nosniff\r\n"
        added += b"Content-Security-Policy: " + policy
        answer = remove_header(remove_header(answer, b"connection"), b"content-security-policy")
        if header_value(answer, b"content-type").startswith("text/html"):
            page = with_note(remove_foreign_links(await server[0].read(-1)))
            answer = remove_header(answer, b"content-length")
            answer += f"\r\nContent-Length: {len(page)}".encode()
            client[1].write(answer + added + b"\r\n\r\n" + page)
            return
        client[1].write(answer + added + b"\r\n\r\n")
        await _relay(server[0], client[1])


@asynccontextmanager
async def _connection(port: int) -> AsyncIterator[tuple[StreamReader, StreamWriter]]:
    """Connect to a port of this computer."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        yield reader, writer
    finally:
        writer.close()


async def _relay_data(head: bytes, client: Any, port: int) -> None:
    """Relay all data in both directions."""
    async with _connection(port) as server:
        server[1].write(head)
        await asyncio.gather(_relay(client[0], server[1]), _relay(server[0], client[1]))


async def _handle_client(
    host_names: frozenset[str],
    handler: Callable[[bytes, Any], Coroutine[Any, Any, None]],
    reader: StreamReader,
    writer: StreamWriter,
) -> None:
    """Serve one client, or reject it with status 403."""
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT)
        if head.startswith(HTTP2) or is_own_host(header_value(head, b"host"), host_names):
            await handler(head, (reader, writer))
            return
        body = UNKNOWN_HOST.encode()
        writer.write(response("403 Forbidden", body, Content_Type="text/plain"))
        await writer.drain()
    except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
        pass  # the client left, timed out, or sent too much; or rerun has not started yet
    except IndexError:
        pass  # no HTTP request
    finally:
        writer.close()


async def serve_gate(
    ports: tuple[socket.socket, socket.socket],
    states: socket.socket,
    inner_ports: tuple[int, int],
    host_names: str,
) -> None:
    """Serve data and page until the node closes its end of `states`.

    Args:
        ports: listening sockets of the data and of the page.
        states: from which the node's states are received.
        inner_ports: ports of rerun's data and page on the loopback.
        host_names: further names of this computer, separated by spaces.
    """
    allowed = frozenset(f"{name}".lower() for name in (*host_names.split(), *computer_names()))
    feed, (data, page) = Feed(), inner_ports
    handlers: tuple[Callable[[bytes, Any], Coroutine[Any, Any, None]], ...] = (
        partial(_relay_data, port=data),
        partial(_serve_page, port=page, data_port=ports[0].getsockname()[1], feed=feed),
    )
    servers = [
        await asyncio.start_server(partial(_handle_client, allowed, handler), sock=port)
        for port, handler in zip(ports, handlers, strict=True)
    ]
    await feed.receive(states)
    for server in servers:
        server.close()


def computer_names() -> set[str]:
    """Return the host names of this computer."""
    name = socket.gethostname().lower()
    return {"localhost", name, f"{name}.local", socket.getfqdn().lower()}


def main() -> int:
    """Run the gate: DATA_SOCKET PAGE_SOCKET STATES INNER_DATA_PORT INNER_PAGE_PORT NAMES.

    The first three are file descriptors, inherited from the node.
    """
    data, page, states = (socket.socket(fileno=int(number)) for number in sys.argv[1:4])
    inner_ports = int(sys.argv[4]), int(sys.argv[5])
    with suppress(KeyboardInterrupt):
        asyncio.run(serve_gate((data, page), states, inner_ports, sys.argv[6]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
