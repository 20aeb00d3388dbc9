"""Clients of a move that fall silent, pauses of the node, and steps of its clock."""

import pytest

from fss_arm_driver.liveness import DISCOVERY, ClockSteps, GoalClient, Stall


@pytest.mark.parametrize(
    ("keep_alive", "heard", "now", "words"),
    [
        (0.5, 10.0, 10.5, ""),
        (0.5, 10.0, 10.6, "its client has been silent for 0.6 s"),
        (0.5, 10.4, 10.6, ""),
        (0.0, 10.0, 1000.0, ""),
    ],
)
def test_silence_ends_what_shall_be_kept_alive(keep_alive, heard, now, words):
    asker = GoalClient(keep_alive, 10.0)
    asker.last_alive = heard
    assert asker.lost_reason(now, connected=True) == words


def test_a_client_may_take_its_time_to_be_seen_and_then_is_missed_at_once():
    asker = GoalClient(0.0, 10.0)
    assert asker.lost_reason(10.0 + DISCOVERY, connected=False) == ""
    assert asker.lost_reason(10.1 + DISCOVERY, connected=False) == "its client is gone"
    asker = GoalClient(0.0, 10.0)
    assert asker.lost_reason(10.2, connected=True) == ""
    assert asker.lost_reason(10.4, connected=False) == "its client is gone"


def test_a_pause_is_reported_for_as_long_as_messages_may_be_old():
    stall, words = Stall(1.0), "this node paused for 5.0 s"
    assert [stall.check(t) for t in (100.0, 100.2, 101.2)] == ["", "", ""]
    assert [stall.check(t) for t in (106.2, 106.4, 107.1, 107.3)] == [words, words, words, ""]


def test_time_that_begins_anew_is_no_stall_and_ends_one():
    stall = Stall(1.0)
    assert [bool(stall.check(t)) for t in (100.0, 105.0, 1.0, 1.2)] == [False, True, False, False]


@pytest.mark.parametrize(("step", "told"), [(-3600.0, "-3600.0 s"), (0.3, "+0.3 s")])
def test_a_clock_that_is_set_is_told_for_a_while(step, told):
    steps, words = ClockSteps(0.1, 1.0), f"the clock of this computer was set by {told}"
    slewed = [steps.check(1e9 + 5e-4 * k, 100.0 + k) for k in range(10)]
    assert not any(slewed)
    assert [steps.check(1e9 + step, t) for t in (110.0, 110.9, 111.1)] == [words, words, ""]
