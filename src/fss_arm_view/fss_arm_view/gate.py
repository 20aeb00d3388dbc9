"""Gate in front of rerun's page and its data: no request of the page leaves the laboratory.

rerun's program serves every client, under any host name. Its page requests fonts and releases from
hosts of rerun's vendor, and reports to them how it is used. The gate is a proxy for both servers:

- A request is accepted if its Host is an address or a name of this computer, so that a foreign
  page cannot reach the servers under its own host name (DNS rebinding). Clients that speak HTTP/2
  from the first line have no Host to check. rerun's own programs do so, but no browser does.
- The page is sent with a policy by which browsers load from this host only. Links that would make
  browsers look up other hosts before they apply the policy are removed.

The gate adds the strip to the page, and answers its requests (`page.py`).

It imports only modules that load quickly, and runs as a separate process:
`python -m fss_arm_view.gate`.
"""

import asyncio
import re
import socket
import sys
import time
from asyncio import StreamReader, StreamWriter
from collections.abc import Callable, Coroutine, Iterable
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from fss_arm_view.page import STATUS_PATH, with_strip

HTTP2 = b"PRI * HTTP/2.0\r\n"
HOST = re.compile(r"(?P<name>\[[\w.:%-]+\]|[\w.-]+)(:(?P<port>\d{1,5}))?", re.ASCII)
HEAD_TIMEOUT = 10.0  # for the head of a request [s]
UNKNOWN_HOST = (
    "unknown host name: open the page by an address or a name of this computer,\n"
    "or start the view with -p names:=[NAME] to allow another name\n"
)
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


def status_response(file: Path) -> bytes:
    """Return the HTTP response for the strip: the node's last content, and its age [s]."""
    try:
        age, status = time.time() - file.stat().st_mtime, file.read_bytes()
    except OSError:
        return b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    text = b'{"age": %.1f, "status": %s}' % (age, status)
    head = f"HTTP/1.1 200 OK\r\nContent-Length: {len(text)}\r\nContent-Type: application/json"
    return f"{head}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n".encode() + text


async def _serve_page(
    head: bytes, client: Any, server: Any, data_port: int, status_file: Path
) -> None:
    """Serve one request for the page, with the policy among the response's headers."""
    if head.split(b" ", 2)[1] == STATUS_PATH.encode():
        client[1].write(status_response(status_file))
        await client[1].drain()
        return
    name = urlsplit(f"//{header_value(head, b'host')}").hostname or ""
    data = f"http://{f'[{name}]' if ':' in name else name}:{data_port}"
    server[1].write(remove_header(head, b"connection") + b"\r\nConnection: close\r\n\r\n")
    answer = await server[0].readuntil(b"\r\n\r\n")
    policy = POLICY.format(data=data).encode()
    added = b"\r\nConnection: close\r\nX-Content-Type-Options: nosniff\r\n"
    added += b"Content-Security-Policy: " + policy
    answer = remove_header(remove_header(answer, b"connection"), b"content-security-policy")
    if header_value(answer, b"content-type").startswith("text/html"):
        page = with_strip(remove_foreign_links(await server[0].read(-1)))
        answer = (
            remove_header(answer, b"content-length") + f"\r\nContent-Length: {len(page)}".encode()
        )
        client[1].write(answer + added + b"\r\n\r\n" + page)
        await client[1].drain()
        return
    client[1].write(answer + added + b"\r\n\r\n")
    await _relay(server[0], client[1])


async def _relay_data(head: bytes, client: Any, server: Any) -> None:
    """Relay all data in both directions."""
    server[1].write(head)
    await asyncio.gather(_relay(client[0], server[1]), _relay(server[0], client[1]))


async def _handle_client(
    port: int,
    host_names: frozenset[str],
    handler: Callable[[bytes, Any, Any], Coroutine[Any, Any, None]],
    reader: StreamReader,
    writer: StreamWriter,
) -> None:
    """Connect one client to a port of this computer, or reject it with status 403."""
    writers = [writer]
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT)
        if not (head.startswith(HTTP2) or is_own_host(header_value(head, b"host"), host_names)):
            writer.write(
                f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(UNKNOWN_HOST)}\r\n"
                f"Content-Type: text/plain\r\nConnection: close\r\n\r\n{UNKNOWN_HOST}".encode()
            )
            await writer.drain()
            return
        server = await asyncio.open_connection("127.0.0.1", port)
        writers.append(server[1])
        await handler(head, (reader, writer), server)
    except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
        pass  # the client left, timed out, or sent too much; or rerun has not started yet
    finally:
        for opened in writers:
            opened.close()


async def serve_gate(
    bind: str,
    ports: tuple[int, int],
    inner_ports: tuple[int, int],
    status_file: Path,
    host_names: str,
) -> None:
    """Serve the ports of the data and of the page until cancelled.

    Raises:
        OSError: a port is in use.
    """
    allowed = frozenset(f"{name}".lower() for name in (*host_names.split(), *computer_names()))
    handlers: tuple[Any, Any] = (
        _relay_data,
        partial(_serve_page, data_port=ports[0], status_file=status_file),
    )
    servers = [
        await asyncio.start_server(
            partial(_handle_client, inner_port, allowed, handler), bind, port
        )
        for port, inner_port, handler in zip(ports, inner_ports, handlers, strict=True)
    ]
    await asyncio.gather(*(server.serve_forever() for server in servers))


def computer_names() -> set[str]:
    """Return the host names of this computer."""
    name = socket.gethostname().lower()
    return {"localhost", name, f"{name}.local", socket.getfqdn().lower()}


def main() -> int:
    """Run the gate: BIND DATA_PORT PAGE_PORT INNER_DATA_PORT INNER_PAGE_PORT STATUS_FILE NAMES."""
    bind, *ports, status_file, host_names = sys.argv[1:]
    data, page, inner_data, inner_page = map(int, ports)
    try:
        asyncio.run(
            serve_gate(bind, (data, page), (inner_data, inner_page), Path(status_file), host_names)
        )
    except OSError as error:
        print(f"view: {error.strerror}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
