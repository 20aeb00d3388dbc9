"""Session with one link (see `fss_link.session`): set points, paths, measurements; no I/O.

| file | one concern each |
| --- | --- |
| `link.py` | `LinkSession`: a link's set points, paths and measurements |
| `active_command.py` | the active set point, until it expires |
| `paths.py` | the timed paths: which segments to send, which the link has |
| `progress.py` | the progress of the active command |
"""

from fss_arm_driver.session.link import COUNTS, LinkSession, Sample
from fss_arm_driver.session.progress import Progress, Status

__all__ = ["COUNTS", "LinkSession", "Progress", "Sample", "Status"]
