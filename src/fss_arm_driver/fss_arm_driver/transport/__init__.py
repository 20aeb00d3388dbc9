"""Transports of frames to a link. The driver's nodes use `Transport`; a URL selects the kind."""

from collections.abc import Sequence
from urllib.parse import SplitResult, parse_qs, urlsplit

from fss_arm_driver.transport.base import BATCH, Line, Transport, TransportError, readable
from fss_arm_driver.transport.copley import CopleyTransport
from fss_arm_driver.transport.stream import open_port, serial, tcp
from fss_arm_driver.transport.udp import UdpTransport

__all__ = [
    "BATCH",
    "FORMS",
    "Line",
    "Transport",
    "TransportError",
    "UdpTransport",
    "is_exposed",
    "open_port",
    "open_transport",
    "readable",
]

#: Form of a URL, by its scheme.
FORMS = {
    "udp": "udp://HOST:PORT?bind=PORT",
    "tcp": "tcp://HOST:PORT",
    "serial": "serial://DEVICE?baud=RATE",
    "copley": "copley://DEVICE?baud=RATE",
}
BAUD = 115_200


def open_transport(
    url: str, link: int = 1, key: bytes | None = None, schemes: Sequence[str] = tuple(FORMS)
) -> Transport:
    """Open the transport that a URL names, in one of FORMS with one of the allowed `schemes`.

    A UDP socket is bound to the local port `bind`, 0 for any. A serial port is opened at once, by
    default at 115200 baud. A TCP connection is made as soon as possible. `link` and `key` are used
    only by `copley`, which makes the frames itself.

    Raises:
        TransportError: the URL is not understood, its host is not known, or its port cannot be
            opened.
    """
    forms = {scheme: FORMS[scheme] for scheme in schemes}
    if not url:  # a default might answer and be the wrong link
        raise TransportError(f"url is missing, expected {' or '.join(forms.values())}")
    scheme = url.partition(":")[0]
    expected = f"expected {forms.get(scheme) or ' or '.join(forms.values())}"
    try:
        if scheme not in forms:
            raise ValueError("no such scheme")
        parts = urlsplit(url)
        if scheme in ("udp", "tcp") and not (parts.hostname and parts.port and not parts.path):
            raise ValueError("no host, or no port")
        if scheme == "udp":
            bind = _option(parts, "bind", 0, range(65536))
            return UdpTransport(str(parts.hostname), int(parts.port or 0), bind)
        if scheme == "tcp":
            _option(parts)
            return tcp(str(parts.hostname), int(parts.port or 0))
        if scheme == "serial":
            baud = _option(parts, "baud", BAUD, range(300, 4_000_001))
            return serial(_device(parts), baud)
        baud = _option(parts, "baud", BAUD, range(9600, BAUD + 1))
        return CopleyTransport(_device(parts), baud, link, key)
    except OSError as error:
        raise TransportError(f"url {url!r} cannot be opened: {error.strerror or error}") from None
    except ValueError as error:
        raise TransportError(f"url is {url!r}, {expected}: {error}") from None


def is_exposed(url: str, keys: str) -> bool:
    """Return True if unsigned frames are sent over a network, not only within this computer."""
    place = urlsplit(url)
    local = place.hostname in ("127.0.0.1", "::1", "localhost")
    return not keys and place.scheme in ("udp", "tcp") and not local


def _device(parts: SplitResult) -> str:
    """Return the device's path; `serial:///dev/ttyUSB0` and `serial://ttyUSB0` are the same."""
    if not (parts.netloc or parts.path.strip("/")):
        raise ValueError("no device")
    return f"/dev/{parts.netloc}{parts.path}" if parts.netloc else parts.path


def _option(parts: SplitResult, name: str = "", default: int = 0, among: range = range(0)) -> int:
    """Return the integer `name` of a URL's query, which must have no other entry."""
    query = parse_qs(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    text = query.pop(name, [str(default)])[-1]
    if query or parts.fragment:
        raise ValueError(f"{next(iter(query), parts.fragment)!r} means nothing here")
    if name and int(text) not in among:
        raise ValueError(f"{name} is {text}, expected {among[0]} to {among[-1]}")
    return int(text)
