"""Session with one link or the base's board. It does no I/O: callers pass datagrams and times.

| file | one concern each; retry times and limits are the constants at the top |
| --- | --- |
| `session.py` | `Session`: composes the others, and describes problems in words |
| `link.py` | `LinkSession`: a link's set points, paths and measurements |
| `arming.py` | arm, disarm, stop, clear faults: the requested and the confirmed state |
| `orders.py` | the active set point, until it expires |
| `paths.py` | the timed paths: which segments to send, which the link has |
| `progress.py` | the progress of the active command |
| `reception.py` | which telemetry is accepted; when the link is lost |
| `clock.py` | the link's clock mapped to the host's |
| `echoes.py` | stamps of commands and their echoes: delay, other drivers |
| `status_log.py` | one log line for each change of state |
| `battery.py` | the remaining battery time |

The rules and their reasons are in docs/reference/protocol.md.
"""

from fss_arm_driver.scale import CommandError
from fss_arm_driver.session.arming import RELEASE_TIMEOUT, Arming
from fss_arm_driver.session.clock import SECOND
from fss_arm_driver.session.link import COUNTS, LinkSession, Sample
from fss_arm_driver.session.progress import Progress, Status
from fss_arm_driver.session.session import TROUBLES, Partner, Session
from fss_arm_driver.session.status_log import Line, StatusLog

__all__ = [
    "COUNTS",
    "RELEASE_TIMEOUT",
    "SECOND",
    "TROUBLES",
    "Arming",
    "CommandError",
    "Line",
    "LinkSession",
    "Partner",
    "Progress",
    "Sample",
    "Session",
    "Status",
    "StatusLog",
]
