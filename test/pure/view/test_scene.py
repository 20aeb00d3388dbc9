"""What the view draws, and how it gets to rerun without anybody waiting."""

import re
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
import rerun_cli

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import BaseReaction
from fss_arm_view import scene
from fss_arm_view.settings import ViewSettings
from fss_arm_view.sink import FILE, Sink, new_file, open_stream


def strips(archetype):
    """The lines of a drawing."""
    return [np.array(strip) for strip in archetype.strips.as_arrow_array().to_pylist()]


def test_the_arm_is_drawn_to_its_tip_with_y_upwards():
    arm, pose, q = paper_arm(), (0.3, -0.2, 0.5), (0.1, 0.2, -0.3, 0.4)
    _, (lines, dots) = scene.together("arm", scene.arm(arm, pose, q))
    tip = tip_pose(arm.vector(), np.array([*pose, *q]))
    drawn, held, ellipse = strips(lines)
    assert len(dots.positions.as_arrow_array()) == 5 + 5  # joints with tip; base and links
    assert drawn.shape == (5, 2)
    np.testing.assert_allclose(drawn[-1], [tip[0], -tip[1]], atol=1e-6)  # rerun keeps float32
    for around in (held, ellipse):
        np.testing.assert_allclose(around[:-1].mean(axis=0), [tip[0], -tip[1]], atol=1e-6)
    # A base that is free recoils: the end effector moves less.
    assert np.ptp(ellipse, axis=0).max() < np.ptp(held, axis=0).max()


def test_each_colour_has_one_meaning():
    meanings = [scene.STONE, scene.STEEL, scene.GHOST, scene.BAND, scene.TIP, scene.PURPLE]
    meanings += [scene.JET, scene.DIFFERENCE, *scene.AXES, *scene.PALETTE]
    apart = [
        np.linalg.norm(np.subtract(a, b)) for k, a in enumerate(meanings) for b in meanings[:k]
    ]
    assert min(apart) > 25.0
    reds = [c for c in meanings if c[0] > 180 and c[1] < 70 and c[2] < 70]
    assert not reds  # which is left to alarms


def test_newtons_and_newton_metres_do_not_share_an_axis():
    assert all(len(set(re.findall(r"\[([^]]+)\]", s.title))) == 1 for s in scene.PLOTS)
    assert {s.name for s in scene.PLOTS if "N s" in s.title} == {"momentum"}
    assert {s.name for s in scene.PLOTS if "N m s" in s.title} == {"spin"}


def test_the_ellipse_of_a_single_link_is_a_line():
    arm = replace(paper_arm(), links=paper_arm().links[:1])
    ellipse = scene.arm(arm, (0.0, 0.0, 0.0), (0.3,))[-1]
    assert np.linalg.matrix_rank(np.diff(ellipse.strips[0], axis=0), tol=1e-6) == 1


def test_a_base_shows_its_heading():
    nose = scene.base((1.0, 2.0, np.pi / 2), scene.STEEL).strips[-1][-1]
    np.testing.assert_allclose(nose, [1.0, -2.0 - scene.BASE / 2], atol=1e-6)


def test_a_planned_way_is_dashed_and_a_zone_lies_about_its_centre():
    way = scene.route([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)])
    np.testing.assert_allclose(way.strips, [[[0, 0], [0.5, 0]], [[1, 0], [1, -1]]], atol=1e-12)
    assert scene.route([]).strips == []
    (around,) = scene.circle((1.0, 2.0), 0.5, scene.PURPLE).strips
    np.testing.assert_allclose(np.hypot(*(around - (1.0, -2.0)).T), 0.5)


def test_a_reaction_is_plotted_in_degrees_and_what_is_unknown_is_left_out():
    message = BaseReaction(torque=0.3, torque_measured=float("nan"))
    message.predicted[2], message.predicted_deviation[2] = np.pi / 2, np.pi / 180
    drawings = dict(scene.reaction(message))
    value = {
        name: drawing.scalars.as_arrow_array().to_pylist()[0]
        for name, drawing in drawings.items()
        if name.startswith("plot/")
    }
    assert value["plot/heading/predicted"] == pytest.approx(90.0)
    band = value["plot/heading/band_above"] - value["plot/heading/band_below"]
    assert band == pytest.approx(2.0)
    assert value["plot/torque/predicted"] == 0.3
    assert "plot/torque/measured" not in value


def test_a_plume_leaves_the_corner_of_its_thruster():
    """The second of the first corner, ahead and to the left, pushes the base to the right."""
    a = scene.BASE / 2
    (jet,) = scene.plumes((1.0, 0.0, np.pi / 2), [False, True, *[False] * 6]).strips
    np.testing.assert_allclose(jet[0], [1.0 - a, -a], atol=1e-6)  # y is drawn downwards
    np.testing.assert_allclose(jet[1:3].mean(axis=0), [1.0 - a - scene.PLUME, -a], atol=1e-6)
    assert not scene.plumes((0.0, 0.0, 0.0), [False] * 8).strips


def test_lines_are_drawn_in_their_frame_and_no_longer_in_another():
    line = [[(0.0, 0.0), (1.0, 0.0)]]
    drawings = {
        in_base: dict(scene.outline(line, "straight paths, fixed", scene.JET, in_base))
        for in_base in (True, False)
    }
    for in_base, drawn in drawings.items():
        count = {path: len(d.strips.as_arrow_array()) for path, d in drawn.items()}
        assert count == {
            "table/fss/straight_paths_fixed": int(in_base),
            "table/outlines/straight_paths_fixed": int(not in_base),
        }


class Stuck:
    """A viewer that takes nothing until it is let go."""

    def __init__(self):
        self.go, self.logged = Event(), []

    def set_time(self, *_, **__):
        self.go.wait(20.0)

    def log(self, entity, *_, **__):
        self.logged.append(entity)

    def flush(self):
        pass


def test_a_viewer_that_is_stuck_holds_nobody_up():
    stuck = Stuck()
    sink = Sink(stuck, rate=1e9, size=10)
    begin = time.monotonic()
    taken = [sink.put(k, [("log", None)]) for k in range(1000)]
    assert time.monotonic() - begin < 5.0  # it would be 20 s each
    assert 10 <= sum(taken) <= 11
    assert sink.counts["dropped"] == 1000 - sum(taken)
    stuck.go.set()
    sink.close()
    assert len(stuck.logged) == sum(taken)


def test_each_thing_has_its_own_rate():
    sink = Sink(Stuck(), rate=1e-3, size=1)
    assert sink.due("a")
    assert not sink.due("a")
    assert sink.due("b")
    assert sink.counts["thinned out"] == 1


def test_a_burst_is_shown_whole_if_it_is_no_more_than_a_second_s_worth():
    sink = Sink(Stuck(), rate=5.0, size=1)
    shown = sum(sink.due("a") for _ in range(1000))
    assert 5 <= shown < 500


def test_a_recording_of_the_view_can_be_read(tmp_path):
    file = tmp_path / "view.rrd"
    sink = Sink(open_stream(FILE, str(file), scene.blueprint()), rate=1e9, size=100)
    sink.put(None, [*scene.ground(), *scene.styles(4)])
    arm = scene.arm(paper_arm(), (0, 0, 0), (0, 0, 0, 0))
    sink.put(1_000_000_000, [scene.together("arm", arm)])
    sink.put(1_000_000_000, [scene.words("armed")])
    sink.close(20.0)
    sink.stream.disconnect()
    rerun = Path(rerun_cli.__file__).parent / "rerun"
    shown = subprocess.run(
        [rerun, "rrd", "print", file], capture_output=True, text=True, timeout=60, check=True
    ).stdout
    for entity in ("/table/edge", "/table/arm", "/log", "/plot/heading/predicted"):
        assert entity in shown


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mode": "file", "file": ""}, "file is empty, expected the name of the recording"),
        ({"mode": "tv"}, "mode is 'tv', expected one of native, web, file, connect"),
        ({"memory": "lots"}, "memory is 'lots', expected a size or a share of all, as 100MB or"),
        ({"bind": "localhost"}, "bind is 'localhost', expected an IP address"),
        ({"rate": 0.0}, "rate is 0.0 Hz, expected a positive number"),
        ({"queue": 0}, "queue is 0, expected 1 or more"),
        ({"port": 70000}, "port is 70000, expected 1 to 65535"),
    ],
)
def test_impossible_settings_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        ViewSettings(**change)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"view\.rrd"):
        new_file(str(tmp_path / "none/view.rrd"))


def test_no_recording_is_written_over(tmp_path):
    (tmp_path / "view.rrd").write_bytes(b"yesterday's")
    names = [new_file(str(tmp_path / "view.rrd")) for _ in range(2)]
    assert names == [str(tmp_path / f"view_{k}.rrd") for k in (1, 2)]
    assert (tmp_path / "view.rrd").read_bytes() == b"yesterday's"
