"""The session with one link or the base's board, without I/O: datagrams in and out, times given.

| file | one concern each; its retry times and limits are the constants at its top |
| --- | --- |
| `session.py` | `Session`: composes the others, and says in words what is wrong |
| `link.py` | `LinkSession`: a link's set points, paths and measurements |
| `arming.py` | arm, disarm, stop, clear faults: what is wanted of the drive, what is confirmed |
| `orders.py` | the set point in force, until it expires |
| `paths.py` | what of the paths in time the link is sent, and has |
| `progress.py` | how far the link has come with it |
| `reception.py` | which telemetry is believed; when the link is lost |
| `clock.py` | the link's clock mapped to the host's |
| `echoes.py` | stamps of commands and their echoes: delay, other drivers |
| `status_log.py` | what has become of it, a line of the log for each change |
| `battery.py` | how long the battery lasts |

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
