"""Which poses of motion capture are believed."""

from math import cos, inf, nan, sin

import pytest

from fss_base_driver.mocap.subjects import Bounds, Subjects

FRAME = 10_000_000  # [ns]
BOUNDS = Bounds(speed=1.0, turn=3.0, settle_time=1.0)


def pose(x, y, heading=0.0):
    return x, y, 0.05, 0.0, 0.0, sin(0.5 * heading), cos(0.5 * heading)


def drifting(k, x=0.0):
    """Slowly along y."""
    return pose(x, 1e-3 * k, 1e-3 * k)


@pytest.fixture
def subjects():
    """Two that have been seen for a second."""
    subjects = Subjects(BOUNDS)
    for k in range(100):
        frame = {"fss": drifting(k), "tip": drifting(k, 1.0)}
        assert subjects.take(k * FRAME, frame) == frame
    return subjects


def test_a_pose_that_is_repeated_is_occluded(subjects):
    frame = {"fss": drifting(99), "tip": drifting(100, 1.0)}
    assert subjects.take(100 * FRAME, frame) == {"tip": frame["tip"]}
    assert subjects.subjects["fss"].counts["unchanged"] == 1
    assert subjects.silent(200 * FRAME, 1.0).keys() == {"fss"}


@pytest.mark.parametrize(
    "bad",
    [(0.0,) * 7, (nan, *pose(0, 0)[1:]), (inf, *pose(0, 0)[1:]), (*pose(0, 0)[:3], 9, 9, 9, 9)],
)
def test_what_is_no_pose_is_not_believed(subjects, bad):
    assert subjects.take(100 * FRAME, {"fss": bad}) == {}
    assert subjects.subjects["fss"].counts["invalid"] == 1
    assert not subjects.doubts(100 * FRAME)
    assert subjects.take(101 * FRAME, {"fss": drifting(101)})


@pytest.mark.parametrize("to", [pose(0.5, 0.1), pose(0.0, 0.1, 1.0)])
def test_a_jump_and_back_is_left_out(subjects, to):
    assert not subjects.take(100 * FRAME, {"fss": to})
    assert subjects.doubts(150 * FRAME) == {"fss": "jumped 0.5 s ago"}
    assert subjects.take(101 * FRAME, {"fss": drifting(101)})
    assert not subjects.doubts(101 * FRAME)


def test_a_subject_that_was_carried_elsewhere_is_believed_after_a_while(subjects):
    believed = [bool(subjects.take(k * FRAME, {"fss": drifting(k, -0.7)})) for k in range(100, 300)]
    assert believed.index(True) == 101  # more than a second after the jump
    assert all(believed[101:])


def test_swapped_subjects_are_named_and_never_believed_until_they_are_back(subjects):
    for k in range(100, 1000):  # nine seconds: at 1 m/s they could have gone there
        assert not subjects.take(k * FRAME, {"fss": drifting(k, 1.0), "tip": drifting(k)})
    assert subjects.doubts(1000 * FRAME) == {
        "fss": "jumped 9.0 s ago to where tip was: swapped names?",
        "tip": "jumped 9.0 s ago to where fss was: swapped names?",
    }
    right = {"fss": drifting(1000), "tip": drifting(1000, 1.0)}
    assert subjects.take(1000 * FRAME, right) == right
    assert not subjects.doubts(1000 * FRAME)


def test_one_that_takes_the_place_of_an_occluded_one_is_named(subjects):
    for k in range(100, 400):
        assert not subjects.take(k * FRAME, {"fss": drifting(k, 1.0)})
    assert "tip" in subjects.doubts(400 * FRAME)["fss"]


def test_a_person_may_say_that_the_names_are_right(subjects):
    subjects.take(100 * FRAME, {"fss": drifting(100, 1.0), "tip": drifting(100)})
    subjects.accept()
    frame = {"fss": drifting(101, 1.0), "tip": drifting(101)}
    assert subjects.take(101 * FRAME, frame) == frame


def test_after_a_gap_a_subject_may_be_as_far_as_it_could_go(subjects):
    assert subjects.take(300 * FRAME, {"fss": pose(1.9, 0.1)})
    assert not subjects.take(500 * FRAME, {"tip": pose(-3.5, 0.1)})
