"""The page that the view serves during the demo, looked at in a browser."""

import re
import signal
import subprocess
import sys
import time
from functools import partial
from threading import Event

import pytest
from browser import CHROMIUM, Page, Picture
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from running import free_port, wait_until

from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import pose_stamped
from fss_arm_ros.qos import SENSOR
from fss_arm_view import scene

ADDRESS = re.compile(r"open (http://\S+)")
#: Parts of the page, as the blueprint shares it out: left, top, right, bottom.
TABLE, LINKS = (0.08, 0.31, 0.31, 0.73), (0.77, 0.14, 1.0, 0.37)
HEADING, BAND = (0.46, 0.14, 0.69, 0.37), (0.46, 0.43, 0.69, 0.66)

#: Pixels of a colour at least, after several moves; a plot without curves has 40, of its legend.
WANTED = {
    "arm": 150, "path of the end effector": 80, "band": 200, "prediction": 200, "links": 120,
    "colours": 300,
}  # fmt: skip


@pytest.fixture
def demo(tmp_path):
    """The main job on the simulated test bed; the ROS domain that it says it is in."""
    command = [sys.executable, "-m", "fss_rehearsal", "demo", "--out", tmp_path / "demo"]
    log = tmp_path / "demo.log"
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)
    try:
        said = re.compile(r"in ROS domain (\d+)").search
        yield wait_until(lambda: said(log.read_text()), 60.0, partial(Event().wait, 0.1))[1]
    finally:
        process.terminate()
        process.wait(60)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium, Debian's package of that name")
def test_the_page_shows_arm_prediction_and_measurement(start, spin, demo, tmp_path):
    ports = ("-p", f"port:={free_port()}", "-p", f"web_port:={free_port()}")
    view = start("fss_arm_view.view_node", "--ros-args", *ports, ROS_DOMAIN_ID=demo)
    start("fss_arm_view.base_reaction_node", ROS_DOMAIN_ID=demo)
    spin([], lambda: ADDRESS.search(view.output), 60.0)
    page = Page(ADDRESS.search(view.output)[1], tmp_path / "browser")
    seen, deadline = {}, time.monotonic() + 300.0
    try:
        while not all(seen.get(what, 0) >= least for what, least in WANTED.items()):
            assert time.monotonic() < deadline, seen
            png = page.picture()
            (tmp_path / "view.png").write_bytes(png)
            picture = Picture(png)
            seen = {
                "arm": picture.count(scene.STEEL, *TABLE),
                "path of the end effector": picture.count(scene.TIP, *TABLE),
                "band": picture.count(scene.BAND, *BAND),
                "prediction": picture.count(scene.GHOST, *HEADING),
                "links": min(picture.count(colour, *LINKS) for colour in scene.PALETTE[:4]),
                "colours": picture.colours(0.0, 0.0, 1.0, 1.0),
            }
    finally:
        page.close()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium, Debian's package of that name")
def test_the_page_says_how_old_its_data_are_and_that_none_come(start, spin, domain, tmp_path):
    ports = ("-p", f"port:={free_port()}", "-p", f"web_port:={free_port()}")
    view = start("fss_arm_view.view_node", "--ros-args", *ports)
    source, sends = Node("source"), [True]
    poses = source.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
    telemetry = source.create_publisher(LinkTelemetry, "link_1/telemetry", SENSOR)

    def send():
        if sends[0]:
            now = source.get_clock().now().nanoseconds
            poses.publish(pose_stamped(now, "world", (0.1, 0.2, 0.3)))
            telemetry.publish(LinkTelemetry(link=1, armed=True, battery=165))

    source.create_timer(0.1, send)
    spin([source], lambda: ADDRESS.search(view.output), 60.0)
    page = Page(ADDRESS.search(view.output)[1], tmp_path / "browser")
    try:

        def says(element, words):
            return spin([source], lambda: words in page.text(element), 120.0)

        hides = "document.getElementById('fss_wait').style.display === 'none'"  # once it draws
        spin(
            [source],
            lambda: page.ask("Runtime.evaluate", expression=hides)["result"].get("value"),
            120.0,
        )
        says("fss", "1 of 1 armed")
        says("fss", "16.5 V, link 1")
        sends[0] = False
        says("fss_age", "NO DATA FOR")
        says("fss", "no telemetrylink 1")
        sends[0] = True
        spin([source], lambda: "NO DATA" not in page.text("fss_age"), 60.0)
        view.process.send_signal(signal.SIGSTOP)
        says("fss_age", "NO DATA FOR")
    finally:
        view.process.send_signal(signal.SIGCONT)
        page.close()
