"""Which warnings are logged: those that begin, and never a flood of them."""

import pytest

from fss_link.complaints import BURST, PAUSE, Complaints


@pytest.fixture
def complaints():
    """With a clock that stands still until it is set."""
    complaints = Complaints(lambda: complaints.now)
    complaints.now = 0.0
    return complaints


def test_one_that_goes_on_is_logged_once_whatever_its_figures(complaints):
    found = ["it is 0.601 s old", "it is 0.612 s old", "", "it is 0.590 s old", "it is no number"]
    assert [complaints.begins("wrench", words) for words in found] == [
        True,
        False,
        False,
        True,
        True,
    ]


def test_kinds_have_nothing_to_do_with_each_other(complaints):
    assert complaints.begins("wrench", "it is old")
    assert complaints.begins("gripper", "it is old")
    assert not complaints.begins("wrench", "it is old")


@pytest.mark.parametrize("words", [("it is old", ""), [chr(ord("a") + i) for i in range(26)]])
def test_who_is_refused_for_ever_new_reasons_floods_no_log(complaints, words):
    """Or by turns with somebody who is not: for an hour, a hundred times a second."""
    logged = 0
    for k in range(360_000):
        complaints.now = 0.01 * k
        logged += complaints.begins("command", words[k % len(words)])
    assert BURST <= logged <= BURST + 3600.0 / PAUSE
    assert complaints.begins("trouble", "nothing can be sent")
