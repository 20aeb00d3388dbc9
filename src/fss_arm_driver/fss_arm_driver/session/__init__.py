"""Session with one link (see `fss_link.session`): set points, paths, measurements; no I/O.

| file | one concern each |
| --- | --- |
| `link.py` | `LinkSession`: a link's set points, paths and measurements |
| `active_command.py` | the active set point, until it expires |
| `paths.py` | the timed paths: which segments to send, which the link has |
| `progress.py` | the progress of the active command |
| `reports.py` | the changes of that progress that are yet to be reported |
"""

from fss_arm_driver.session.link import COUNTS, LinkSession, Sample
from fss_arm_driver.session.progress import Progress, Status
from fss_arm_driver.session.reports import CommandReports, Report

__all__ = ["COUNTS", "CommandReports", "LinkSession", "Progress", "Report", "Sample", "Status"]
