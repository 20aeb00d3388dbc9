"""The page that the view serves during the demo, looked at in a browser."""

import re
import socket
import subprocess
import sys
import time
from functools import partial
from threading import Event

import pytest
from browser import CHROMIUM, Page, Picture
from running import wait_until

from fss_arm_view import scene

ADDRESS = re.compile(r"open (http://\S+)")
#: Parts of the page, as the blueprint shares it out: left, top, right, bottom.
TABLE, LINKS = (0.05, 0.28, 0.38, 0.75), (0.77, 0.1, 1.0, 0.8)
HEADING, BAND = (0.42, 0.08, 0.75, 0.27), (0.42, 0.31, 0.75, 0.48)

#: Pixels of a colour at least, after several moves; a plot without curves has 40, of its legend.
WANTED = {
    "arm": 150, "path of the end effector": 120, "band": 350, "prediction": 300, "links": 300,
    "colours": 300,
}  # fmt: skip


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture
def demo(tmp_path):
    """The main job on the simulated test bed; the ROS domain that it says it is in."""
    command = [sys.executable, "-m", "fss_sim.rehearsal", "demo", "--out", tmp_path / "demo"]
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
