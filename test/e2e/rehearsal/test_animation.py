"""A mission's page, played in a browser that has nothing but its file."""

from functools import partial
from threading import Event

import numpy as np
import pytest
from browser import CHROMIUM, Page, Picture
from running import wait_until

from fss_arm_model.description import paper_arm
from fss_arm_ros import palette, report
from fss_rehearsal.animation import animation
from fss_rehearsal.rehearsed import Rehearsed

BLUE, PURPLE, CYAN = map(palette.rgb, (palette.MEASURED, palette.TARGET, palette.THRUST))


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium, Debian's package of that name")
def test_a_mission_plays_and_is_moved_by_hand(tmp_path):
    time = 100.0 + np.arange(0.0, 20.0, 0.02)
    q = np.zeros((len(time), 7))
    q[:, 0] = -1.0 + 0.02 * (time - time[0])
    target = np.tile([1.0, 0.8, 0.1], (len(time), 1))
    valves = np.zeros((len(time), 8), bool)
    valves[time > 110.0, 3] = True
    phases = [(101.0, "approach"), (115.0, "reach")]
    film = animation(paper_arm(), time, q, target, time > 118.0, valves, phases, (0.2, 0.0, 0.0))
    file = report.write(tmp_path / "report", Rehearsed([], html=film).report("A mission", ""))
    assert "://" not in file.read_text()  # it asks nobody for anything
    page = Page(file.as_uri(), tmp_path / "browser")

    def run(code):
        return page.ask("Runtime.evaluate", expression=f"{code}")["result"].get("value")

    def to(when):
        run(f"document.querySelector('#film input').value = {when}")
        run("document.querySelector('#film input').oninput()")
        return run("document.querySelector('#film output').textContent")

    def shown():
        return float(run("document.querySelector('#film output').textContent").split()[0])

    try:
        pause = partial(Event().wait, 0.1)
        wait_until(lambda: run("document.querySelector('#film output')?.textContent"), 30.0, pause)
        assert shown() == 0.0
        assert to(5.0) == "5.0 of 19.9 s, approach"
        before = Picture(page.picture())
        assert before.count(BLUE) > 200 < before.count(PURPLE)
        sample = before.count(CYAN)  # in the legend
        assert to(19.0) == "19.0 of 19.9 s, reach, target held"
        assert Picture(page.picture()).count(CYAN) > sample + 50
        to(5.0)
        run("document.querySelector('#film button').click()")
        wait_until(lambda: shown() > 6.0, 30.0, pause)
        run("document.querySelector('#film button').click()")
        assert run("document.querySelector('#film button').textContent") == "Play"
    finally:
        page.close()
