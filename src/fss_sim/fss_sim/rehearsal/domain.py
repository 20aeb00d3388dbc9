"""A ROS domain with ports that nobody else on this computer has; what leads to others left out.

Free of ROS, so that it can be called before anything imports rclpy.
"""

import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple
from uuid import uuid4

#: Of the workspace, be the packages linked to from install/ or copied there.
CONFIG = next(
    (d / "config" for d in Path(__file__).resolve().parents if (d / "config/fastdds.xml").exists()),
    Path("config"),
)
DOMAINS = range(65, 0, -1)  # for rehearsals; the tests have 66 to 101
FIRST_PORT, PORTS = 7400, 250  # of domain 0, and of each domain (DDSI-RTPS 9.6.1)
UNUSED = 200  # DDS has the ports before this one, for 95 processes
#: What would lead a process to other computers, or to nodes that it shall not know of.
LEADS = (
    "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "ROS_SUPER_CLIENT",
    "ROS_SECURITY_ENABLE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_ENVIRONMENT_FILE",
    "CYCLONEDDS_URI",
)  # fmt: skip


class Domain(NamedTuple):
    """A reserved domain."""

    number: int
    enclave: str  # by which its nodes know each other
    holder: socket.socket  # reserves it until closed, at the latest with the process

    def ports(self, count: int) -> list[int]:
        """UDP ports that go with the domain, and are nobody else's, either."""
        first = FIRST_PORT + PORTS * self.number + UNUSED
        return list(range(first, first + count))

    def urls(self, count: int) -> list[str]:
        """Where drivers find links that have the first ports."""
        ports = self.ports(2 * count)
        pairs = zip(ports[:count], ports[count:], strict=True)
        return [f"udp://127.0.0.1:{link}?bind={driver}" for link, driver in pairs]

    def enter(self) -> None:
        """Take this process, and what it starts from now on, there."""
        for name in LEADS:
            os.environ.pop(name, None)
        fast_dds = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps").startswith("rmw_fastrtps")
        os.environ |= {
            "ROS_DOMAIN_ID": str(self.number),
            # To Fast DDS, LOCALHOST would mean shared memory too; its profile has loopback alone.
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT" if fast_dds else "LOCALHOST",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(CONFIG / "fastdds.xml"),
        }


def reserve(numbers: Sequence[int] = DOMAINS) -> Iterator[Domain]:
    """The domains that nobody on this computer has reserved or is in, each until the next is asked.

    A name of an abstract socket is unique within the network namespace, as the ports of a domain
    are, and goes with the process. It is taken before anybody is looked for.

    Raises:
        OSError: there is no further one.
    """
    for number in numbers:
        holder = socket.socket(socket.AF_UNIX)
        with suppress(OSError):  # reserved by another process
            holder.bind(f"\0fss_arm_domain_{number}")
            if is_silent(number):
                yield Domain(number, f"/rehearsal_{uuid4().hex}", holder)
        holder.close()
    raise OSError(f"none of the ROS domains {min(numbers)} to {max(numbers)} is free")


def is_silent(number: int) -> bool:
    """Whether no process has a port of the domain: each one in it has."""
    first = FIRST_PORT + PORTS * number
    for port in range(first, first + PORTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True
