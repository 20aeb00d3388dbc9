"""Each change of a command's status is reported once, in the order of the commands."""

from fss_arm_driver.protocol import Mode
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session import CommandReports, Progress, Report, Status
from fss_arm_model.description import paper_arm

SCALE = Scale(paper_arm().links[0])
SET_POINT = SetPoint(Mode.POSITION, 0, 0, 0, clamped=False)


def test_each_change_is_reported_once():
    reports, progress = CommandReports(), Progress(SET_POINT, 5, SCALE)
    assert not reports.pending
    assert reports.take_changes(100) == []
    reports.add(None)
    reports.add(progress)
    assert reports.pending
    assert reports.take_changes(100) == [Report(Status.ACCEPTED, "", 105)]
    reports.add(progress)  # given again
    assert not reports.pending
    assert reports.take_changes(100) == []
    progress.end(Status.ABORTED, "disarmed")
    assert reports.pending
    assert reports.take_changes(200) == [Report(Status.ABORTED, "disarmed", 105)]


def test_the_end_of_a_replaced_command_precedes_the_next_one():
    reports = CommandReports()
    first, second, third = (Progress(SET_POINT, given, SCALE) for given in (5, 6, 6))
    reports.add(first)
    reports.take_changes(0)
    first.end(Status.ABORTED, "replaced")
    reports.add(second)
    second.end(Status.ABORTED, "replaced")
    reports.add(third)
    assert reports.take_changes(10) == [
        Report(Status.ABORTED, "replaced", 5),
        Report(Status.ABORTED, "replaced", 16),
        Report(Status.ACCEPTED, "", 16),
    ]
    assert not reports.pending
