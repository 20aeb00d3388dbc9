"""State of a vehicle's scene: what is drawn with a pose, and for how long."""

from math import inf, nan

import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_arm_view import scene
from fss_arm_view.mission import MISSION_TIMEOUT, Mission
from fss_arm_view.vehicle_scene import MAX_PREDICTION_AGE, FrameLoss, VehicleScene

POSE = (0.1, 0.2, 0.3)
PATH = [(0.5, 0.0), (0.5, 1.0)]


def count_lines(drawings, entity):
    return len(dict(drawings)[entity][0].strips)


def test_a_mission_lasts_as_long_as_it_is_published():
    mission = Mission()
    assert mission.is_over(1)
    assert mission.path(1) == []
    assert mission.receive(SECOND, 0.6, PATH)
    end = SECOND + MISSION_TIMEOUT
    assert (mission.path(end - 1), mission.keep_out(end - 1)) == (PATH, 0.6)
    assert (mission.path(end), mission.keep_out(end)) == ([], 0.0)
    assert not mission.is_over(end)
    assert mission.is_over(end + 1)


def test_the_path_of_a_mission_precedes_that_of_the_base():
    mission = Mission()
    mission.receive(SECOND, nan, PATH)
    assert mission.keep_out(SECOND) == 0.0
    assert not mission.receive_base_path(2 * SECOND, [(1.0, 1.0)])
    assert mission.path(2 * SECOND) == PATH
    assert not mission.receive(2 * SECOND, nan, [])  # no path: the previous one stays
    later = SECOND + MISSION_TIMEOUT + 1
    assert mission.receive_base_path(later, [(1.0, 1.0), (nan, 0.0)])
    assert mission.path(later) == [(1.0, 1.0)]


def test_lost_frames_are_averaged():
    loss = FrameLoss()
    assert [loss.add(sequence) for sequence in (7, 8)] == [0.0, 0.0]
    assert loss.add(11) == pytest.approx(0.05 * 2 / 3)
    assert loss.add(3) == pytest.approx(0.95 * 0.05 * 2 / 3)  # the numbers restarted


def test_the_plume_of_a_short_pulse_is_drawn_after_the_next_command():
    vehicle = VehicleScene(paper_arm())
    plain = count_lines(vehicle.draw_base(0, POSE), "table/arm")
    vehicle.fire(0, [0.02] + 7 * [0.0])
    vehicle.fire(SECOND // 10, 8 * [0.0])
    assert count_lines(vehicle.draw_base(SECOND // 8, POSE), "table/arm") == plain + 1
    assert count_lines(vehicle.draw_base(SECOND // 3, POSE), "table/arm") == plain


def test_the_base_is_drawn_with_path_plumes_and_prediction_until_they_are_old():
    vehicle = VehicleScene(paper_arm(), "fss1")
    plain = count_lines(vehicle.draw_base(0, POSE), "table/arm")
    vehicle.fire(0, [0.0, 1e-3, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    for rejected in (inf, nan, -1.0):
        vehicle.fire(0, [1.0, 1.0, rejected, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert count_lines(vehicle.draw_base(SECOND // 10, POSE), "table/arm") == plain + 2
    assert count_lines(vehicle.draw_base(SECOND // 2, POSE), "table/arm") == plain + 1
    assert count_lines(vehicle.draw_base(SECOND, POSE), "table/arm") == plain
    vehicle.store_prediction_error(SECOND, [0.1, 0.0, 0.0])
    vehicle.mission.receive(SECOND, 0.0, PATH)
    assert count_lines(vehicle.draw_base(2 * SECOND, POSE), "table/arm") == plain + 2 + 2
    old = SECOND + MAX_PREDICTION_AGE
    assert count_lines(vehicle.draw_base(old, POSE), "table/arm") == plain
    vehicle.store_prediction_error(old, [nan, 0.0, 0.0])  # thrusters have fired
    assert count_lines(vehicle.draw_base(old, POSE), "table/arm") == plain
    assert "table/name" in dict(vehicle.draw_base(old, POSE))


def test_the_zone_about_the_target_is_drawn_during_a_mission():
    vehicle = VehicleScene(paper_arm())
    assert count_lines(vehicle.draw_target(0, POSE), "table/target") == 2
    vehicle.mission.receive(0, 0.6, [])
    assert count_lines(vehicle.draw_target(1, POSE), "table/target") == 3
    assert count_lines(vehicle.draw_target(MISSION_TIMEOUT, POSE), "table/target") == 2


def test_a_trail_grows_only_with_motion_and_is_reset():
    vehicle = VehicleScene(paper_arm())
    assert vehicle.extend_trail("tip_path", (0.0, 0.0))
    assert not vehicle.extend_trail("tip_path", (0.5 * scene.MIN_TRAIL_STEP, 0.0))
    assert vehicle.extend_trail("tip_path", (2.0 * scene.MIN_TRAIL_STEP, 0.0))
    vehicle.q[0] = 0.2
    vehicle.reset()
    assert not vehicle.trails["tip_path"]
    assert vehicle.q[0] == 0.2


def test_a_name_is_added_to_the_legend_once():
    legend = scene.Legend()
    entity, _ = legend.add("target", scene.TARGET_COLOR)
    assert entity == f"table/legend/{len(scene.LEGEND)}"
    assert legend.add("target", scene.TARGET_COLOR) is None
    legend.reset()
    assert legend.names == [name for name, _ in scene.LEGEND]
