"""Signs of an overloaded computer."""

from fss_rehearsal.load import Load, overload


def test_losses_of_links_and_a_late_test_bed_are_signs_of_overload():
    quiet, busy = Load(), Load()
    for stamp, simulated in ((100.0, 1.0), (101.0, 1.5), (110.0, 3.0), (120.0, 20.5)):
        quiet.add("/testbed", stamp, {"simulated time [s]": str(stamp - 99.5)})
        busy.add("/testbed", stamp, {"simulated time [s]": str(simulated)})
    for link, lost in (("/link_1", 0), ("/link_2", 1), ("/link_2", 3), ("/link_1", 1)):
        busy.add(link, 0.0, {"times lost": str(lost)})
        quiet.add("/record", 0.0, {"lost": "7"})
    assert overload([quiet]) == ""
    assert overload([quiet, busy]) == (
        "the result is not valid, because the computer was overloaded (links lost 4 times, test "
        "bed late by up to 8.0 s)"
    )
