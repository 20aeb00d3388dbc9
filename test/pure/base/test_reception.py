"""Why no poses arrive, and what is wrong with those that do, in words."""

import pytest

from fss_arm_model.units import SECOND
from fss_base_driver.mocap import Bounds, Reception, Relay, Subjects
from fss_base_driver.mocap.reception import describe_problems
from fss_base_driver.mocap.relays import describe_waiting

UPRIGHT = 0.0, 0.0, 0.0, 1.0
WAITING = ["/a: it has no publisher"]


@pytest.mark.parametrize(
    ("counts", "connected", "waiting", "words"),
    [
        ([], False, [], "waiting for vicon at x: it does not answer"),
        ([2, 0], True, [], "no subject in the frames of vicon at x"),
        ([], None, WAITING, "waiting for /a: it has no publisher"),
        ([], True, WAITING, "no frame yet from vicon at x"),
        ([], None, [], "no frame yet from vicon at x"),
        ([2], True, [], "no frame any more from vicon at x"),
        ([1], None, WAITING, f"no frame any more from vicon at x; waiting for {WAITING[0]}"),
    ],
)
def test_the_reason_of_a_silence(counts, connected, waiting, words):
    reception = Reception("vicon at x", 0)
    for count in counts:
        reception.add(count, 0)
    assert reception.loss_reason(connected, waiting) == words


def test_only_frames_with_a_subject_end_a_silence_and_a_failure():
    reception = Reception("vicon at x", 0)
    reception.failure = "the receiver ended"
    reception.add(0, SECOND)
    assert (reception.silence(2 * SECOND), reception.failure) == (2.0, "the receiver ended")
    reception.add(1, SECOND)
    assert (reception.silence(2 * SECOND), reception.failure) == (1.0, "")
    assert reception.frames == 2


def test_problems_with_subjects_are_named():
    subjects = Subjects(Bounds(1.0, 3.0, 1.0))
    choose = "list the required ones in the parameter subjects"
    subjects.filter_frame(0, {f"s{k}": (float(k), 0.0, 0.0, *UPRIGHT) for k in range(101)}, 0)
    assert describe_problems(subjects, ["s1", "tip"], ["a b"], SECOND // 2, 1.0) == [
        "tip was not seen yet",
        f"'a b' is no valid topic name: rename it, or {choose}",
        f"more than 100 subjects: the rest is ignored; {choose}",
    ]
    subjects.filter_frame(SECOND, {"s0": (9.5, 0.0, 0.0, *UPRIGHT)}, SECOND)
    words = describe_problems(subjects, [], [], 2 * SECOND, 1.5)
    assert words[0].startswith("s0 jumped 1.0 s ago to where s")
    assert words[1] == "s1 has no new pose for 2.0 s"


def test_relays_wait_with_a_reason():
    relays = [Relay("fss", "/a"), Relay("", "/b", obstacle="")]
    assert describe_waiting(relays) == WAITING
