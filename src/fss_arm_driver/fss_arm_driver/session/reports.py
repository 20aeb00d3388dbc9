"""Reports of the progress of a link's commands: each change once, the commands in their order."""

from collections import deque
from typing import NamedTuple

from fss_arm_driver.session.progress import Progress, Status


class Report(NamedTuple):
    """Change of the status of a command."""

    status: Status
    reason: str
    given: int  # time of day at which the command was given [ns]


class CommandReports:
    """Changes of the progress of commands that are yet to be reported."""

    def __init__(self) -> None:
        self._commands: deque[Progress] = deque()  # the last one, after those that it replaced
        self._reported: tuple[int, Status] | None = None  # time and status of the last report
        self._given = 0, 0  # when its command was given, and the time of day then [ns]

    def add(self, progress: Progress | None) -> None:
        """Add the progress of the session's present command, if it is a new one."""
        if progress and (not self._commands or progress is not self._commands[-1]):
            self._commands.append(progress)

    @property
    def pending(self) -> bool:
        """True if the status of the last command has changed since its last report."""
        return bool(self._commands) and self._key(self._commands[-1]) != self._reported

    def take_changes(self, offset: int) -> list[Report]:
        """Return the new reports.

        Args:
            offset: time of day minus the session's clock [ns]. All reports of a command have the
                same time of day, also if the clock is set meanwhile.
        """
        reports = []
        for progress in self._commands:
            if self._key(progress) != self._reported:
                self._reported = self._key(progress)
                if progress.given != self._given[0]:
                    self._given = progress.given, progress.given + offset
                reports.append(Report(progress.status, progress.reason, self._given[1]))
        while len(self._commands) > 1:
            self._commands.popleft()
        return reports

    def _key(self, progress: Progress) -> tuple[int, Status]:
        return progress.given, progress.status
