"""Likely causes from a few observations: named, and never one of good data."""

from dataclasses import replace

import pytest
from early_causes import ERRORS, cause_of, observed

from fss_arm_calib.kinematic.early_cause import MIN_OBSERVATIONS


@pytest.mark.parametrize("n", [4, 6])
@pytest.mark.parametrize("words", ERRORS)
def test_an_error_of_the_laboratory_is_named_after_five_observations(words, n):
    q, tip, guess = observed(n, 5, seed=n)
    found = cause_of(*ERRORS[words](q, tip), guess)
    assert found.startswith(words)
    assert found.endswith(" mm")
    assert "the residuals of 5 observations are " in found


@pytest.mark.parametrize("n", range(1, 9))
def test_good_observations_are_never_accused(n):
    for seed in range(25):
        for count in (MIN_OBSERVATIONS, 5, 13):
            assert cause_of(*observed(n, count, seed)) == ""


def test_the_data_of_another_arm_have_no_cause_among_these():
    q, tip, _ = observed(4, 6, seed=1)
    *_, other = observed(4, 6, seed=2)
    links = tuple(replace(link, a=link.a + 0.3) for link in other.links)
    assert cause_of(q, tip, replace(other, links=links)) == ""


def test_two_observations_are_too_few_for_a_cause():
    q, tip, guess = observed(4, MIN_OBSERVATIONS - 1, seed=3)
    assert cause_of(-q, tip, guess) == ""
