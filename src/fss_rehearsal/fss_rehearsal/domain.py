"""Reservation of a ROS domain whose ports no other process on this computer uses.

Environment variables that lead to other nodes are removed. The module does not import ROS, so that
it can be called before anything imports rclpy.
"""

import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple
from uuid import uuid4

#: Folder config/ of the workspace, whether install/ links to the packages or has copies of them.
CONFIG = next(
    (d / "config" for d in Path(__file__).resolve().parents if (d / "config/fastdds.xml").exists()),
    Path("config"),
)
DOMAINS = range(65, 0, -1)  # for rehearsals; the tests use 66 to 101
FIRST_PORT, PORTS = 7400, 250  # first port of domain 0, ports per domain (DDSI-RTPS 9.6.1)
FIRST_UNUSED_PORT = 200  # first port of a domain that DDS does not use, with up to 95 processes
#: Environment variables that could connect a process to other computers, or to foreign nodes.
CONNECTING_VARIABLES = (
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "ROS_SECURITY_ENABLE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_ENVIRONMENT_FILE",
    "CYCLONEDDS_URI",
)


class Domain(NamedTuple):
    """A reserved ROS domain."""

    number: int
    enclave: str  # identifies the nodes of this rehearsal
    reservation: socket.socket  # reserves the domain until it is closed or the process ends

    def ports(self, count: int) -> list[int]:
        """Return UDP ports that belong to the domain and that DDS leaves unused."""
        first = FIRST_PORT + PORTS * self.number + FIRST_UNUSED_PORT
        return list(range(first, first + count))

    def urls(self, count: int) -> list[str]:
        """Return the URLs with which drivers reach links on the domain's first ports."""
        ports = self.ports(2 * count)
        pairs = zip(ports[:count], ports[count:], strict=True)
        return [f"udp://127.0.0.1:{link}?bind={driver}" for link, driver in pairs]

    def enter(self) -> None:
        """Move this process, and each process that it starts from now on, to the domain."""
        for name in CONNECTING_VARIABLES:
            os.environ.pop(name, None)
        is_fast_dds = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps").startswith(
            "rmw_fastrtps"
        )
        os.environ |= {
            "ROS_DOMAIN_ID": str(self.number),
            # With LOCALHOST, Fast DDS would also use shared memory; its profile has loopback only.
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT" if is_fast_dds else "LOCALHOST",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(CONFIG / "fastdds.xml"),
        }


def reserve(numbers: Sequence[int] = DOMAINS) -> Iterator[Domain]:
    """Yield domains that no process on this computer has reserved or uses.

    Each domain stays reserved until the next one is requested. An abstract socket's name is unique
    within the network namespace, like the ports of a domain, and disappears with the process. It
    is bound before the domain is checked for other processes.

    Raises:
        OSError: no further domain is free.
    """
    for number in numbers:
        reservation = socket.socket(socket.AF_UNIX)
        with suppress(OSError):  # reserved by another process
            reservation.bind(f"\0fss_arm_domain_{number}")
            if is_unused(number):
                yield Domain(number, f"/rehearsal_{uuid4().hex}", reservation)
        reservation.close()
    raise OSError(f"none of the ROS domains {min(numbers)} to {max(numbers)} is free")


def is_unused(number: int) -> bool:
    """Return True if no process has bound a port of the domain, as each participant does."""
    first = FIRST_PORT + PORTS * number
    for port in range(first, first + PORTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True
