"""Acceptance of poses of motion capture."""

from math import cos, inf, nan, sin

import pytest

from fss_base_driver.mocap.subjects import MAX_SUBJECTS, Bounds, Subjects

FRAME = 10_000_000  # [ns]
BOUNDS = Bounds(speed=1.0, turn=3.0, settle_time=1.0)


def pose(x, y, heading=0.0):
    return x, y, 0.05, 0.0, 0.0, sin(0.5 * heading), cos(0.5 * heading)


def drifting(k, x=0.0):
    """Slowly along y."""
    return pose(x, 1e-3 * k, 1e-3 * k)


class Stream(Subjects):
    def frame(self, k, poses, stamp=None):
        return self.filter_frame(k * FRAME if stamp is None else stamp, poses, k * FRAME)


@pytest.fixture
def subjects():
    """Two that have been seen for a second."""
    subjects = Stream(BOUNDS)
    for k in range(100):
        frame = {"fss": drifting(k), "tip": drifting(k, 1.0)}
        assert subjects.frame(k, frame) == frame
    return subjects


def test_a_pose_that_is_repeated_is_occluded(subjects):
    frame = {"fss": drifting(99), "tip": drifting(100, 1.0)}
    assert subjects.frame(100, frame) == {"tip": frame["tip"]}
    assert subjects.subjects["fss"].counts["unchanged"] == 1
    assert subjects.stale_subjects(200 * FRAME, 1.0).keys() == {"fss"}


@pytest.mark.parametrize(
    "bad",
    [(0.0,) * 7, (nan, *pose(0, 0)[1:]), (inf, *pose(0, 0)[1:]), (*pose(0, 0)[:3], 9, 9, 9, 9)],
)
def test_what_is_no_pose_is_not_believed(subjects, bad):
    assert subjects.frame(100, {"fss": bad}) == {}
    assert subjects.subjects["fss"].counts["invalid"] == 1
    assert not subjects.rejection_reasons(100 * FRAME)
    assert subjects.frame(101, {"fss": drifting(101)})


@pytest.mark.parametrize("to", [pose(0.5, 0.1), pose(0.0, 0.1, 1.0)])
def test_a_jump_and_back_is_left_out(subjects, to):
    assert not subjects.frame(100, {"fss": to})
    assert subjects.rejection_reasons(150 * FRAME) == {"fss": "jumped 0.5 s ago"}
    assert subjects.frame(101, {"fss": drifting(101)})
    assert not subjects.rejection_reasons(101 * FRAME)


def test_a_subject_that_was_carried_elsewhere_is_believed_after_a_while(subjects):
    believed = [bool(subjects.frame(k, {"fss": drifting(k, -0.7)})) for k in range(100, 300)]
    assert believed.index(True) == 101  # more than a second after the jump
    assert all(believed[101:])


def test_swapped_subjects_are_named_and_never_believed_until_they_are_back(subjects):
    for k in range(100, 1000):  # nine seconds: at 1 m/s they could have gone there
        assert not subjects.frame(k, {"fss": drifting(k, 1.0), "tip": drifting(k)})
    assert subjects.rejection_reasons(1000 * FRAME) == {
        "fss": "jumped 9.0 s ago to where tip was: swapped names?",
        "tip": "jumped 9.0 s ago to where fss was: swapped names?",
    }
    right = {"fss": drifting(1000), "tip": drifting(1000, 1.0)}
    assert subjects.frame(1000, right) == right
    assert not subjects.rejection_reasons(1000 * FRAME)


def test_one_that_takes_the_place_of_an_occluded_one_is_named(subjects):
    for k in range(100, 400):
        assert not subjects.frame(k, {"fss": drifting(k, 1.0)})
    assert "tip" in subjects.rejection_reasons(400 * FRAME)["fss"]


def test_a_person_may_say_that_the_names_are_right(subjects):
    subjects.frame(100, {"fss": drifting(100, 1.0), "tip": drifting(100)})
    subjects.accept_all()
    frame = {"fss": drifting(101, 1.0), "tip": drifting(101)}
    assert subjects.frame(101, frame) == frame


def test_after_a_gap_a_subject_may_be_as_far_as_it_could_go(subjects):
    assert subjects.frame(300, {"fss": pose(1.9, 0.1)})
    assert not subjects.frame(500, {"tip": pose(-3.5, 0.1)})


@pytest.mark.parametrize("step", [-3600, 3600])
def test_a_clock_that_is_set_hides_no_silence_and_keeps_no_doubt(subjects, step):
    """Another computer's stamps jump by an hour, just as a subject is carried elsewhere."""
    later = step * 1_000_000_000
    stamps = {k: k * FRAME + later * (k >= 101) for k in range(100, 300)}
    carried = {k: {"fss": drifting(k, -0.7)} for k in stamps}
    assert not subjects.frame(100, carried[100])
    believed = [bool(subjects.frame(k, carried[k], stamps[k])) for k in range(101, 300)]
    assert believed.index(True) == 100  # a second after the jump, by the steady clock
    assert subjects.stale_subjects(450 * FRAME, 1.0) == pytest.approx({"fss": 1.51, "tip": 3.51})


def test_whoever_sends_names_fills_no_memory(subjects):
    strangers = {f"stranger_{i}": drifting(i) for i in range(10 * MAX_SUBJECTS)}
    assert len(subjects.frame(100, strangers)) == MAX_SUBJECTS - 2
    assert len(subjects.subjects) == MAX_SUBJECTS
    assert subjects.ignored == 9 * MAX_SUBJECTS + 2
    assert subjects.frame(101, {"fss": drifting(101)})
