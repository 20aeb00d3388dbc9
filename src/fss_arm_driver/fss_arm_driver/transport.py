"""Transport to a link: as to all electronics, or directly to a Copley drive."""

from urllib.parse import SplitResult

from fss_arm_driver.copley.transport import CopleyTransport
from fss_link.transport import BAUD, SCHEMES, Scheme, Transport, device_path, integer_option
from fss_link.transport import open_transport as open_shared

COPLEY_FORM = "copley://DEVICE?baud=RATE"


def open_transport(url: str, link: int = 1, key: bytes | None = None) -> Transport:
    """Open the transport that a URL names; `link` and `key` are for `copley`, which makes frames.

    Raises:
        TransportError: the URL is not understood, its host is not known, or its port cannot be
            opened.
    """

    def open_copley(parts: SplitResult) -> Transport:
        baud = integer_option(parts, "baud", BAUD, range(9600, BAUD + 1))
        return CopleyTransport(device_path(parts), baud, link, key)

    return open_shared(url, {**SCHEMES, "copley": Scheme(COPLEY_FORM, open_copley)})
