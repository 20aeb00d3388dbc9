"""Bounds of references: infeasible ones are rejected, those of the guidance are accepted."""

import numpy as np
import pytest

from fss_arm_ros.convert import SECOND
from fss_gnc import messages
from fss_gnc.bounds import check_reference, check_stamp
from fss_gnc.guidance.limits import braking
from fss_gnc.guidance.settings import GuidanceSettings
from fss_gnc.reference import Body, Path, Reference

TABLE = (4.0, 2.0)


def path(times, x, speed=None, acceleration=None):
    """Return a path along y with derivatives or without."""
    knots = [row for row in (x, speed, acceleration) if row is not None]
    along = np.array(knots, dtype=float).T[:, :, None]
    return Path(np.array(times, dtype=float), along * [0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        (path([0], [1.01]), "points[0].transforms[0].y is 1.01 m, expected -1 to 1 m"),
        (path([0, 9], [0, 0], [0, 2]), "points[1].velocities[0].linear.y is 2 m/s, expected -1 to"),
        (
            path([0, 9], [0, 0], [0, 0], [-5, 0]),
            "points[0].accelerations[0].linear.y is -5 m/s^2, expected -1 to 1 m/s^2",
        ),
        (path([0, 0.1], [0, 0.9]), "reference at 0 s, linear.y is 9 m/s, expected -1 to 1 m/s"),
        (path([0, 60], [0, 0], [0.9, -0.9]), "reference at 4.6875 s, y is 3.88916 m, expected"),
        (path([-1, 0], [0, 0]), "points[0].time_from_start is -1 s, expected 0 to 86400 s"),
        (path([0, 1e5], [0, 0]), "points[1].time_from_start is 100000 s, expected 0 to 86400 s"),
    ],
)
def test_infeasible_reference_is_rejected(reference, words):
    with pytest.raises(ValueError) as error:  # noqa: PT011
        check_reference(reference, TABLE)
    assert str(error.value).startswith(words)


@pytest.mark.parametrize(
    "reference",
    [
        path([0], [1.0]),
        Path.between(Reference.at_rest([0.0, -0.9, 0.0]), [1.9, 0.9, 3.0], 0.0, 100.0),
        path([0, 10], [-1.0, 1.0]),
        path([0, 1], [0.9, 1.1], [0.3, 0.1]),  # beyond the edge: a base that brakes too late
    ],
)
def test_reference_on_the_table_is_accepted(reference):
    check_reference(reference, TABLE)


@pytest.mark.parametrize("speed", [0.05, 0.8])
def test_braking_is_accepted_until_the_base_has_passed_the_edge(speed):
    settings, start = GuidanceSettings(), np.array([0.0, 0.7, 3.0])
    way = braking(settings, Body(start, np.array([0.0, speed, 0.5])))
    for t in np.arange(0.0, way.end_time + 1.0, 0.1):
        if way.at(t).pose[1] > 1.0:
            break
        message = messages.trajectory(way, t, SECOND, settings.horizon, 0.25)
        check_reference(messages.path(message), TABLE)


PRESENT = 100 * SECOND  # [ns]


@pytest.mark.parametrize(
    ("stamp", "end", "words"),
    [
        (PRESENT - SECOND, 0.0, ""),
        (PRESENT - 60 * SECOND, 59.5, ""),
        (PRESENT + SECOND, 5.0, ""),
        (0, 200.0, "header.stamp is 0, expected the start time of the points"),
        (PRESENT + 5 * SECOND, 5.0, "header.stamp is 5.0 s in the future, expected at most 1 s"),
        (PRESENT - 5 * SECOND, 2.0, "the last point was 3.0 s ago, expected at most 1 s"),
    ],
)
def test_path_stamp_must_be_close_to_the_present(stamp, end, words):
    if not words:
        check_stamp(stamp, PRESENT, end, 1.0)
        return
    with pytest.raises(ValueError) as error:  # noqa: PT011
        check_stamp(stamp, PRESENT, end, 1.0)
    assert str(error.value) == words
