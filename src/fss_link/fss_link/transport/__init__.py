"""Transports of frames to electronics. Nodes use `Transport`; a URL selects the kind."""

import errno
from collections.abc import Callable, Mapping
from typing import NamedTuple
from urllib.parse import SplitResult, parse_qs, urlsplit

from fss_link.transport.base import BATCH, Line, Transport, TransportError, readable
from fss_link.transport.stream import open_port, serial, tcp
from fss_link.transport.udp import UdpTransport

__all__ = [
    "BATCH",
    "BAUD",
    "SCHEMES",
    "Line",
    "Scheme",
    "Transport",
    "TransportError",
    "UdpTransport",
    "device_path",
    "exposure",
    "integer_option",
    "open_port",
    "open_transport",
    "readable",
]

BAUD = 115_200


class Scheme(NamedTuple):
    """Scheme of URLs."""

    form: str  # of a URL
    open: Callable[[SplitResult], Transport]  # raises OSError or ValueError


def device_path(parts: SplitResult) -> str:
    """Return the device's path; `serial:///dev/ttyUSB0` and `serial://ttyUSB0` are the same."""
    if not (parts.netloc or parts.path.strip("/")):
        raise ValueError("no device")
    return f"/dev/{parts.netloc}{parts.path}" if parts.netloc else parts.path


def integer_option(
    parts: SplitResult, name: str = "", default: int = 0, among: range = range(0)
) -> int:
    """Return the integer `name` of a URL's query, which must have no other entry."""
    query = parse_qs(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    text = query.pop(name, [str(default)])[-1]
    if query or parts.fragment:
        raise ValueError(f"{next(iter(query), parts.fragment)!r} is no option of this URL")
    if name and int(text) not in among:
        raise ValueError(f"{name} is {text}, expected {among[0]} to {among[-1]}")
    return int(text)


def _host_and_port(parts: SplitResult) -> tuple[str, int]:
    if not (parts.hostname and parts.port and not parts.path):
        raise ValueError("no host, or no port")
    return parts.hostname, parts.port


def _open_udp(parts: SplitResult) -> Transport:
    address = _host_and_port(parts)
    return UdpTransport(*address, integer_option(parts, "bind", 0, range(65536)))


def _open_tcp(parts: SplitResult) -> Transport:
    address = _host_and_port(parts)
    integer_option(parts)
    return tcp(*address)


def _open_serial(parts: SplitResult) -> Transport:
    return serial(device_path(parts), integer_option(parts, "baud", BAUD, range(300, 4_000_001)))


#: Schemes of all electronics, by name.
SCHEMES = {
    "udp": Scheme("udp://HOST:PORT?bind=PORT", _open_udp),
    "tcp": Scheme("tcp://HOST:PORT", _open_tcp),
    "serial": Scheme("serial://DEVICE?baud=RATE", _open_serial),
}


def open_transport(url: str, schemes: Mapping[str, Scheme] = SCHEMES) -> Transport:
    """Open the transport that a URL names.

    A UDP socket is bound to the local port `bind`, 0 for any. A serial port is opened at once, by
    default at 115200 baud. A TCP connection is made as soon as possible.

    Raises:
        TransportError: the URL is not understood, its host is not known, or its port cannot be
            opened.
    """
    forms = " or ".join(scheme.form for scheme in schemes.values())
    if not url:  # a default might answer and be the wrong link
        raise TransportError(f"url is missing, expected {forms}")
    scheme = schemes.get(url.partition(":")[0])
    try:
        if scheme is None:
            raise ValueError("unknown scheme")
        return scheme.open(urlsplit(url))
    except OSError as error:
        why = error.strerror or error
        if error.errno == errno.EADDRINUSE:
            why = f"{why}; another driver of this link runs, or choose another bind=PORT"
        raise TransportError(f"url {url!r} cannot be opened: {why}") from None
    except ValueError as error:
        expected = scheme.form if scheme else forms
        raise TransportError(f"url is {url!r}, expected {expected}: {error}") from None


def exposure(url: str, keys: str, threat: str) -> str:
    """Return a warning if unsigned frames are sent over a network, else an empty text.

    Args:
        url: of the partner.
        keys: file of the keys that sign frames; empty: none.
        threat: what an attacker can do, in words.
    """
    place = urlsplit(url)
    local = place.hostname in ("127.0.0.1", "::1", "localhost")
    if keys or local or place.scheme not in ("udp", "tcp"):
        return ""
    who = "any computer on this network can"
    return f"{url}: frames are not signed, so {who} {threat}; see docs/how-to/security.md"
