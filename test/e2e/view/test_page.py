"""The live page in a browser: what it draws of a scene, and how old that is."""

import re
import signal
import time

import pytest
from browser import CHROMIUM, Page, Picture
from running import free_port
from view_scene import Scene

from fss_arm_ros import palette

ADDRESS = re.compile(r"open (http://\S+)")
#: Pixels of a color, at least: of the arm, the paths, the target and the thrusters.
WANTED = {"MEASURED": 400, "PREDICTED": 100, "TIP": 50, "TARGET": 100, "THRUST": 40, "BAND": 50}
#: The age of the drawing once a second, by the page's own clock, which is that of the scene.
RECORD = """
window.ages = [];
let stamp = 0;
document.addEventListener("drawn", ({detail}) => { stamp = detail.stamp; });
setInterval(() => { if (stamp) ages.push(Date.now() / 1000 - stamp); }, 100);
"""
MAX_AGE = 2.0  # [s]


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium, Debian's package of that name")
def test_the_page_draws_the_scene_and_says_how_old_it_is(start, spin, domain, tmp_path):
    ports = ("-p", f"port:={free_port()}", "-p", f"web_port:={free_port()}")
    view, scene = start("fss_arm_view.view_node", "--ros-args", *ports), Scene()
    spin([scene], lambda: ADDRESS.search(view.output), 60.0)
    page = Page(ADDRESS.search(view.output)[1], tmp_path / "browser", (1100, 900))

    def run(code):
        return page.ask("Runtime.evaluate", expression=code, returnByValue=True)["result"]

    def says(element, words):
        return spin([scene], lambda: words in page.text(element), 120.0)

    def is_drawn():
        png = page.picture()
        (tmp_path / "view.png").write_bytes(png)
        picture = Picture(png)
        colors = {name: palette.rgb(getattr(palette, name)) for name in WANTED}
        found = {name: picture.count(color) for name, color in colors.items()}
        return all(found[name] >= least for name, least in WANTED.items())

    try:
        says("status", "live: data")
        says("strips", "4 of 4 armed")
        says("phase", "capture: approach")
        spin([scene], is_drawn, 120.0)
        run(RECORD)
        end = time.monotonic() + 5.0
        spin([scene], lambda: time.monotonic() > end)
        ages = run("ages")["value"]
        assert len(ages) > 10
        assert max(ages) < MAX_AGE
        scene.sends = False
        says("status", "NO DATA FOR")
        says("strips", "link 1, 2, 3, 4")
        scene.sends = True
        says("status", "live: data")
        view.process.send_signal(signal.SIGSTOP)
        says("status", "NO DATA FOR")
    finally:
        view.process.send_signal(signal.SIGCONT)
        page.close()
    assert view.stop(signal.SIGINT) == 0
    assert "rerun" not in view.output  # no error of a connection that has ended
    assert "gRPC" not in view.output
