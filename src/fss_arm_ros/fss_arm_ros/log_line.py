"""Line of a node's log, for code that does not know ROS."""

from typing import NamedTuple


class LogLine(NamedTuple):
    """Line to be logged by `events.report`."""

    words: str
    bad: bool = False  # a warning
    for_operator: bool = False  # also for the event log
