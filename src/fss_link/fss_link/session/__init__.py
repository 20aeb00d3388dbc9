"""Session with electronics: the driver's side, without I/O; callers pass datagrams and times.

| file | one concern each; retry times and limits are the constants at the top |
| --- | --- |
| `session.py` | `Session`: composes the others, and describes problems in words |
| `arming.py` | arm, disarm, stop, clear faults: the requested and the confirmed state |
| `reception.py` | which telemetry is accepted; when the electronics are lost |
| `clock.py` | the electronics' clock mapped to the host's |
| `echoes.py` | stamps of commands and their echoes: delay, other drivers |
| `status_log.py` | one log line for each change of state |
| `battery.py` | the remaining battery time |

The rules and their reasons are in docs/reference/protocol.md.
"""

from fss_link.session.arming import RELEASE_TIMEOUT, Arming
from fss_link.session.session import FRAME_PROBLEMS, CommandError, Partner, Session
from fss_link.session.status_log import StatusLog

__all__ = [
    "FRAME_PROBLEMS",
    "RELEASE_TIMEOUT",
    "Arming",
    "CommandError",
    "Partner",
    "Session",
    "StatusLog",
]
