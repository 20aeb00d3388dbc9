"""Data have a date; simulated time, from 1970 on, is none."""

from fss_arm_model.units import SECOND
from fss_arm_ros.dates import format_period, format_time

DAY = 1_795_694_646 * SECOND  # 2026-11-26 12:04:06 UTC


def test_data_have_a_date_unless_they_are_simulated():
    assert format_time(DAY) == "2026-11-26 12:04 UTC"
    assert format_time(312 * SECOND) == "312 s of simulated time"
    assert format_period(4 * SECOND, 312 * SECOND) == "4 to 312 s of simulated time"
