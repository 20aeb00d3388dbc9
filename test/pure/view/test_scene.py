"""Drawings of the view, and the queue that passes them to rerun without blocking."""

import re
import time
from dataclasses import replace
from threading import Event
from unittest.mock import Mock

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import BaseReaction
from fss_arm_view import scene
from fss_arm_view.settings import ViewSettings
from fss_arm_view.sink import Sink, new_file


def strips(archetype):
    """Return the lines of a drawing."""
    return [np.array(strip) for strip in archetype.strips.as_arrow_array().to_pylist()]


def test_the_arm_is_drawn_to_its_tip_with_y_upwards():
    arm, pose, q = paper_arm(), (0.3, -0.2, 0.5), (0.1, 0.2, -0.3, 0.4)
    _, (lines, dots) = scene.combine("arm", scene.arm(arm, pose, q))
    tip = tip_pose(arm.vector(), np.array([*pose, *q]))
    drawn, fixed, ellipse = strips(lines)
    assert len(dots.positions.as_arrow_array()) == 5 + 5  # joints with tip; base and links
    assert drawn.shape == (5, 2)
    np.testing.assert_allclose(drawn[-1], [tip[0], -tip[1]], atol=1e-6)  # rerun keeps float32
    for circle in (fixed, ellipse):
        np.testing.assert_allclose(circle[:-1].mean(axis=0), [tip[0], -tip[1]], atol=1e-6)
    # A free base recoils: the end effector moves less.
    assert np.ptp(ellipse, axis=0).max() < np.ptp(fixed, axis=0).max()


def test_different_units_do_not_share_an_axis():
    assert all(len(set(re.findall(r"\[([^]]+)\]", s.title))) == 1 for s in scene.PLOTS)
    assert {s.name for s in scene.PLOTS if "N s" in s.title} == {"momentum"}
    assert {s.name for s in scene.PLOTS if "N m s" in s.title} == {"spin"}


def test_the_ellipse_of_a_single_link_is_a_line():
    arm = replace(paper_arm(), links=paper_arm().links[:1])
    ellipse = scene.arm(arm, (0.0, 0.0, 0.0), (0.3,))[-1]
    assert np.linalg.matrix_rank(np.diff(ellipse.strips[0], axis=0), tol=1e-6) == 1


def test_a_base_shows_its_heading():
    nose = scene.base((1.0, 2.0, np.pi / 2), scene.MEASURED_COLOR).strips[-1][-1]
    np.testing.assert_allclose(nose, [1.0, -2.0 - scene.BASE_EDGE / 2], atol=1e-6)


def test_a_planned_path_is_dashed_and_a_zone_is_a_circle():
    path_drawing = scene.route([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)])
    np.testing.assert_allclose(
        path_drawing.strips, [[[0, 0], [0.5, 0]], [[1, 0], [1, -1]]], atol=1e-12
    )
    assert scene.route([]).strips == []
    (circle,) = scene.circle((1.0, 2.0), 0.5, scene.TARGET_COLOR).strips
    np.testing.assert_allclose(np.hypot(*(circle - (1.0, -2.0)).T), 0.5)


def test_a_reaction_is_plotted_in_degrees_without_unknown_values():
    message = BaseReaction(torque=0.3, torque_measured=float("nan"))
    message.predicted[2], message.predicted_deviation[2] = np.pi / 2, np.pi / 180
    drawings = dict(scene.reaction_drawings(message))
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


def test_a_plume_starts_at_the_corner_of_its_thruster():
    """The second thruster of the front left corner pushes the base to the right."""
    a = scene.BASE_EDGE / 2
    (jet,) = scene.plumes((1.0, 0.0, np.pi / 2), [False, True, *[False] * 6]).strips
    np.testing.assert_allclose(jet[0], [1.0 - a, -a], atol=1e-6)  # y is drawn downwards
    np.testing.assert_allclose(jet[1:3].mean(axis=0), [1.0 - a - scene.PLUME_LENGTH, -a], atol=1e-6)
    assert not scene.plumes((0.0, 0.0, 0.0), [False] * 8).strips


def test_lines_are_drawn_only_in_their_frame():
    line = [[(0.0, 0.0), (1.0, 0.0)]]
    drawings = {
        in_base: dict(scene.outline(line, "straight paths, fixed", scene.THRUST_COLOR, in_base))
        for in_base in (True, False)
    }
    for in_base, drawn in drawings.items():
        count = {path: len(d.strips.as_arrow_array()) for path, d in drawn.items()}
        assert count == {
            "table/fss/straight_paths_fixed": int(in_base),
            "table/outlines/straight_paths_fixed": int(not in_base),
        }


def test_a_stalled_viewer_does_not_block():
    released, viewer = Event(), Mock()  # which accepts nothing until it is released
    viewer.set_time.side_effect = lambda *_, **__: released.wait(20.0)
    sink = Sink(viewer, rate=1e9, size=10)
    begin = time.monotonic()
    accepted = [sink.enqueue(k, [("log", None)]) for k in range(1000)]
    assert time.monotonic() - begin < 5.0  # each drawing would take 20 s
    assert 10 <= sum(accepted) <= 11
    assert sink.counts["dropped"] == 1000 - sum(accepted)
    released.set()
    sink.close()
    assert viewer.log.call_count == sum(accepted)


def test_each_item_has_its_own_rate_limit_and_none_is_drawn_during_a_pause():
    sink = Sink(Mock(), rate=1e-3, size=1)
    sink.is_paused = True  # while the page is late
    assert not sink.due("a")
    sink.is_paused = False
    assert sink.due("a")
    assert not sink.due("a")
    assert sink.due("b")
    assert sink.counts["rate-limited"] == 2


def test_a_burst_of_one_second_is_shown_completely():
    sink = Sink(Mock(), rate=5.0, size=1)
    shown = sum(sink.due("a") for _ in range(1000))
    assert 5 <= shown < 500


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mode": "file", "file": ""}, "file is empty, expected the name of the recording"),
        ({"mode": "tv"}, "mode is 'tv', expected one of native, web, file, connect"),
        ({"memory": "lots"}, "memory is 'lots', expected a size or a percentage, such as 100MB or"),
        ({"bind": "localhost"}, "bind is 'localhost', expected an IP address"),
    ],
)
def test_invalid_settings_are_rejected(change, words):
    with pytest.raises(ValueError, match=words):
        ViewSettings(**change)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"view\.rrd"):
        new_file(str(tmp_path / "none/view.rrd"))


def test_recordings_are_not_overwritten(tmp_path):
    (tmp_path / "view.rrd").write_bytes(b"yesterday's")
    names = [new_file(str(tmp_path / "view.rrd")) for _ in range(2)]
    assert names == [str(tmp_path / f"view_{k}.rrd") for k in (1, 2)]
    assert (tmp_path / "view.rrd").read_bytes() == b"yesterday's"
