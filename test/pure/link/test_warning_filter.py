"""Logged warnings: new ones, at a limited rate."""

import pytest

from fss_link.warning_filter import BURST_LINES, LINE_INTERVAL, WarningFilter


@pytest.fixture
def warnings():
    """With a clock that is constant until it is set."""
    warnings = WarningFilter(lambda: warnings.now)
    warnings.now = 0.0
    return warnings


def test_one_that_goes_on_is_logged_once_whatever_its_figures(warnings):
    found = ["it is 0.601 s old", "it is 0.612 s old", "", "it is 0.590 s old", "it is no number"]
    assert [warnings.is_new("wrench", words) for words in found] == [True, False, False, True, True]


def test_kinds_have_nothing_to_do_with_each_other(warnings):
    assert warnings.is_new("wrench", "it is old")
    assert warnings.is_new("gripper", "it is old")
    assert not warnings.is_new("wrench", "it is old")


@pytest.mark.parametrize("words", [("it is old", ""), [chr(ord("a") + i) for i in range(26)]])
def test_who_is_refused_for_ever_new_reasons_floods_no_log(warnings, words):
    """Or alternating with an accepted client: for an hour, a hundred times a second."""
    logged = 0
    for k in range(360_000):
        warnings.now = 0.01 * k
        logged += warnings.is_new("command", words[k % len(words)])
    assert BURST_LINES <= logged <= BURST_LINES + 3600.0 / LINE_INTERVAL
    assert warnings.is_new("trouble", "nothing can be sent")
