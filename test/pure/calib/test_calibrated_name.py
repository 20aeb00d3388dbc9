"""A calibrated arm is named by the source and the date of its data."""

import pytest

from fss_arm_calib.outcome import calibrated_name
from fss_arm_model.units import SECOND

DAY = 1_795_694_646 * SECOND  # 2026-11-26 12:04:06 UTC
HASH = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("arm", "source", "end", "name"),
    [
        ("cad", "live", DAY, "cad, calibrated live, 2026-11-26 12:04 UTC"),
        ("cad", f"bag_1 {HASH}", 9 * SECOND, "cad, calibrated from bag_1, 9 s of simulated time"),
        (
            "cad, calibrated live, 8 s of simulated time",
            f"a b {HASH}, c\n {HASH} (3 messages recovered, 9 bytes lost)",
            DAY,
            "cad, calibrated from a b, c?, 2026-11-26 12:04 UTC",
        ),
    ],
)
def test_a_calibrated_arm_is_named_by_source_and_date(arm, source, end, name):
    assert calibrated_name(arm, source, end) == name
