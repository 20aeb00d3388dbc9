"""Links of the test bed that were swapped: refused and told by the driver's processes."""

from dataclasses import replace

import pytest
from rclpy.node import Node
from running import OWN
from std_srvs.srv import SetBool

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_rehearsal.processes import Nodes

SLACK = {"timeout": 4.0, "watchdog": 6.0}  # of a busy computer


@pytest.fixture
def arm_file(tmp_path):
    """The description that expects links 7, 8, 9, 10."""
    arm, path = paper_arm(), tmp_path / "arm.yaml"
    links = (replace(link, serial=i) for i, link in enumerate(arm.links, 7))
    save(replace(arm, links=tuple(links)), path)
    return path


@pytest.mark.slow  # by default: node/driver/test_link_node.py
def test_swapped_and_replaced_links_are_refused_and_the_others_armed(spin, tmp_path, arm_file):
    user = Node("user")
    clients = [user.create_client(SetBool, f"link_{i}/arm") for i in (1, 2, 3, 4)]

    def answer(client):
        spin([user], client.service_is_ready, 60.0)
        future = client.call_async(SetBool.Request(data=True))
        spin([user], future.done, 30.0)
        return future.result().message

    def told(client):
        """The answer once the link has reported its serial number."""
        message = ""
        while not message or "not yet reported" in message or "is lost" in message:
            message = answer(client)
        return message

    with Nodes(tmp_path / "nodes", print, OWN) as nodes:
        serials = [7, 9, 8, 23]  # 8 and 9 in each other's place, 23 in that of 10
        nodes.start("testbed", "fss_sim", "testbed", ports=OWN.ports(4), serials=serials)
        nodes.start(
            "link_1", "fss_arm_driver", "link", urls=OWN.urls(4), arm=str(arm_file), **SLACK
        )
        first, second, third, fourth = map(told, clients)
    assert first == "link_1 is armed"
    for message, came, expected in ((second, 9, 8), (third, 8, 9), (fourth, 23, 10)):
        assert f"serial number is {came}, expected {expected}" in message
        assert str(arm_file) in message
