"""ROS domain of a rehearsal: reserved, unused, independent of the environment."""

import os
import socket
import subprocess
import sys
from unittest.mock import patch

import pytest

from fss_rehearsal.domain import CONFIG, reserve

HOLD = """
from fss_rehearsal.domain import reserve
domain = next(reserve())
print(domain.number, flush=True)
input()
"""


def test_concurrent_processes_get_different_domains_and_ports():
    holders = [
        subprocess.Popen(
            [sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(4)
    ]
    numbers = [int(holder.stdout.readline()) for holder in holders]
    for holder in holders:
        holder.communicate("\n")
    assert len(set(numbers)) == 4


def test_a_skipped_domain_is_released_and_one_in_use_is_skipped():
    domains = reserve()
    first, second = next(domains), next(domains)
    assert first.reservation.fileno() == -1
    again = next(reserve([first.number]))
    assert set(again.ports(50)).isdisjoint(second.ports(50))
    with pytest.raises(OSError, match=f"none of the ROS domains {second.number} to"):
        next(reserve([second.number]))
    again.reservation.close()
    # The first port of the domain's fourth process, and one used by another vendor.
    for offset in (16, 0):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 7400 + 250 * first.number + offset))
            with pytest.raises(OSError, match="none"):
                next(reserve([first.number]))


@pytest.mark.parametrize(
    ("rmw", "reach"), [("", "SYSTEM_DEFAULT"), ("rmw_cyclonedds_cpp", "LOCALHOST")]
)
def test_exported_variables_do_not_connect_it_to_other_nodes(rmw, reach):
    exported = {
        "ROS_DOMAIN_ID": "0",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "ROS_STATIC_PEERS": "192.168.1.10",
        "ROS_DISCOVERY_SERVER": "192.168.1.10:11811",
        "ROS_SUPER_CLIENT": "TRUE",
        "FASTRTPS_DEFAULT_PROFILES_FILE": "/mine.xml",
    }
    with patch.dict(os.environ, exported | ({"RMW_IMPLEMENTATION": rmw} if rmw else {})):
        domain = next(reserve())
        domain.enter()
        assert {name: os.environ.get(name) for name in exported} == {
            "ROS_DOMAIN_ID": str(domain.number),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": reach,
            "ROS_STATIC_PEERS": None,
            "ROS_DISCOVERY_SERVER": None,
            "ROS_SUPER_CLIENT": None,
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(CONFIG / "fastdds.xml"),
        }
