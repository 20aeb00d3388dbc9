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

from fss_arm_view.page import NOW, with_strip

HTTP2 = b"PRI * HTTP/2.0\r\n"
PATIENCE = 10.0  # timeout for the head of a request [s]
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:; "
    "connect-src 'self' {data}; form-action 'none'; frame-ancestors 'self'"
)


def is_own(host: str, names: Iterable[str]) -> bool:
    """Return True if a Host header, with or without port, is an IP address or one of `names`."""
    try:
        name = urlsplit(f"//{host.strip()}").hostname or ""
    except ValueError:
        return False
    try:
        ip_address(name)
    except ValueError:
        return name in names
    return True


def header(head: bytes, name: bytes) -> str:
    """Return a header's value from the head of a message; empty if it is absent or repeated."""
    found = [
        line.partition(b":")[2].decode("latin-1").strip()
        for line in head.split(b"\r\n")[1:]
        if line.partition(b":")[0].lower() == name
    ]
    return found[0] if len(found) == 1 else ""


def without(head: bytes, name: bytes) -> bytes:
    """Return the head of a message without a header, and without its final empty line."""
    lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    return b"\r\n".join(line for line in lines if line.partition(b":")[0].lower() != name)


def shut_in(page: bytes) -> bytes:
    """Return the page without links to other hosts."""
    return re.sub(rb"<link\b[^>]*\bhref=.https?://[^>]*>", b"", page)


async def _pump(reader: StreamReader, writer: StreamWriter) -> None:
    with suppress(OSError):
        while chunk := await reader.read(1 << 16):
            writer.write(chunk)
            await writer.drain()
        writer.write_eof()


def now(file: Path) -> bytes:
    """Return the HTTP response for the strip: the node's last content, and its age [s]."""
    try:
        age, said = time.time() - file.stat().st_mtime, file.read_bytes()
    except OSError:
        return b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    text = b'{"age": %.1f, "said": %s}' % (age, said)
    head = f"HTTP/1.1 200 OK\r\nContent-Length: {len(text)}\r\nContent-Type: application/json"
    return f"{head}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n".encode() + text


async def _page(head: bytes, here: Any, there: Any, data_port: int, said: Path) -> None:
    """Serve one request for the page, with the policy among the response's headers."""
    if head.split(b" ", 2)[1] == NOW.encode():
        here[1].write(now(said))
        await here[1].drain()
        return
    name = urlsplit(f"//{header(head, b'host')}").hostname or ""
    data = f"http://{f'[{name}]' if ':' in name else name}:{data_port}"
    there[1].write(without(head, b"connection") + b"\r\nConnection: close\r\n\r\n")
    answer = await there[0].readuntil(b"\r\n\r\n")
    policy = POLICY.format(data=data).encode()
    added = b"\r\nConnection: close\r\nX-Content-Type-Options: nosniff\r\n"
    added += b"Content-Security-Policy: " + policy
    answer = without(without(answer, b"connection"), b"content-security-policy")
    if header(answer, b"content-type").startswith("text/html"):
        page = with_strip(shut_in(await there[0].read(-1)))
        answer = without(answer, b"content-length") + f"\r\nContent-Length: {len(page)}".encode()
        here[1].write(answer + added + b"\r\n\r\n" + page)
        await here[1].drain()
        return
    here[1].write(answer + added + b"\r\n\r\n")
    await _pump(there[0], here[1])


async def _data(head: bytes, here: Any, there: Any) -> None:
    """Relay all data in both directions."""
    there[1].write(head)
    await asyncio.gather(_pump(here[0], there[1]), _pump(there[0], here[1]))


async def _guard(
    port: int,
    names: frozenset[str],
    serve: Callable[[bytes, Any, Any], Coroutine[Any, Any, None]],
    reader: StreamReader,
    writer: StreamWriter,
) -> None:
    """Connect one client to a port of this computer, or reject it with status 403."""
    writers = [writer]
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
        if not (head.startswith(HTTP2) or is_own(header(head, b"host"), names)):
            text = "this computer is not reached under that name: -p names:=[NAME] allows it\n"
            writer.write(
                f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(text)}\r\n"
                f"Content-Type: text/plain\r\nConnection: close\r\n\r\n{text}".encode()
            )
            await writer.drain()
            return
        there = await asyncio.open_connection("127.0.0.1", port)
        writers.append(there[1])
        await serve(head, (reader, writer), there)
    except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
        pass  # the client left, timed out, or sent too much; or rerun has not started yet
    finally:
        for each in writers:
            each.close()


async def guard(
    bind: str, ports: tuple[int, int], inner: tuple[int, int], said: Path, names: str
) -> None:
    """Serve the ports of the data and of the page until cancelled.

    Raises:
        OSError: a port is in use.
    """
    known = frozenset(f"{name}".lower() for name in (*names.split(), *own_names()))
    serve: tuple[Any, Any] = _data, partial(_page, data_port=ports[0], said=said)
    servers = [
        await asyncio.start_server(partial(_guard, within, known, how), bind, port)
        for port, within, how in zip(ports, inner, serve, strict=True)
    ]
    await asyncio.gather(*(server.serve_forever() for server in servers))


def own_names() -> set[str]:
    """Return the host names of this computer."""
    name = socket.gethostname().lower()
    return {"localhost", name, f"{name}.local", socket.getfqdn().lower()}


def main() -> int:
    """Run the gate: BIND DATA_PORT PAGE_PORT INNER_DATA_PORT INNER_PAGE_PORT SAID NAMES."""
    bind, *ports, said, names = sys.argv[1:]
    data, page, inner_data, inner_page = map(int, ports)
    try:
        asyncio.run(guard(bind, (data, page), (inner_data, inner_page), Path(said), names))
    except OSError as error:
        print(f"view: {error.strerror}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
