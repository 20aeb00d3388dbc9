"""Damaged bags: nothing else is read than was written, unless that is said."""

from itertools import islice

import pytest
from damaged_bags import BAGS, Case, Trial, cases, wrong


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    return Trial(tmp_path_factory.mktemp("bags"))


def gone_wrong(trial, count, first):
    """What should not have become of so many cases."""
    tried = [(case, trial.run(case)) for case in islice(cases(BAGS, first), count)]
    return [(case, out) for case, out in tried if wrong(out)]


@pytest.mark.parametrize("first", range(0, 20, 10))
def test_damage_is_seen_or_can_not_be(trial, first):
    """Bytes of messages without checksums cannot; all else is told, in a line."""
    assert gone_wrong(trial, 10, first) == []


#: That went wrong once.
FOUND = [
    Case("standard", "bits flipped", 11059),  # the length of a message index
    Case("standard", "sizes, times", 22901),  # the length of a name in the header
    Case("standard", "bytes overwritten", 13359),  # the name of who wrote it
]


@pytest.mark.parametrize("case", FOUND, ids=str)
def test_damage_once_found_stays_found(trial, case):
    assert not wrong(outcome := trial.run(case)), outcome


@pytest.mark.slow
@pytest.mark.parametrize("first", range(10_000, 20_000, 1000))
def test_damage_of_many_kinds_is_seen_or_can_not_be(trial, first):
    assert gone_wrong(trial, 1000, first) == []
