"""Damaged bags: only data that were written are read, or the damage is reported."""

from itertools import islice

import pytest
from damaged_bags import BAGS, Case, Trial, cases, wrong
from ros_bags import make_bag

from fss_arm_bags.integrity import DamageError, examine


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    return Trial(tmp_path_factory.mktemp("bags"))


def failed_cases(trial, count, first):
    """Return the cases, out of `count`, whose damage was neither reported nor undetectable."""
    tried = [(case, trial.run(case)) for case in islice(cases(BAGS, first), count)]
    return [(case, out) for case, out in tried if wrong(out)]


@pytest.mark.parametrize("first", range(0, 20, 10))
def test_detectable_damage_is_reported(trial, first):
    """Damage of messages without checksums is undetectable; all other damage is reported."""
    assert failed_cases(trial, 10, first) == []


@pytest.mark.parametrize(
    ("at", "words"), [(400, "its data are damaged"), (-60, "its index is damaged")]
)
def test_a_flipped_bit_is_found_by_the_checksum_of_its_part(tmp_path, at, words):
    file = make_bag(tmp_path) / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[at] ^= 1
    file.write_bytes(data)
    with pytest.raises(DamageError, match=f"^{words}$"):
        examine(file)


#: Cases that failed once.
REGRESSIONS = [
    Case("standard", "bits flipped", 11059),  # the length of a message index
    Case("standard", "sizes, times", 22901),  # the length of a name in the header
    Case("standard", "bytes overwritten", 13359),  # the name of who wrote it
]


@pytest.mark.parametrize("case", REGRESSIONS, ids=str)
def test_earlier_failures_stay_fixed(trial, case):
    assert not wrong(outcome := trial.run(case)), outcome


@pytest.mark.slow
@pytest.mark.parametrize("first", range(10_000, 20_000, 1000))
def test_many_kinds_of_damage_are_reported(trial, first):
    assert failed_cases(trial, 1000, first) == []
