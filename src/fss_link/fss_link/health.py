"""Diagnostic status of a session with a link or the base's board."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any

from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Health
from fss_link.session import FRAME_PROBLEMS, Session
from fss_link.transport import Transport

BATTERY_WARNING_TIME = 600.0  # remaining battery time below which to warn [s]

#: Names of counters in diagnostics, all since the driver started; others are their own names.
COUNTER_NAMES = {
    "received": "frames received",
    "accepted": "frames accepted",
    "length": "frames refused: length",
    "magic": "frames refused: not of this protocol",
    "version": "frames refused: version of the protocol",
    "kind": "frames refused: kind",
    "crc": "frames refused: checksum",
    "signature": "frames refused: signature",
    "field": "frames refused: value out of range",
    "foreign": "frames refused: another link or board",
    "impossible": "frames refused: impossible measurement",
    "unproven": "frames refused: maybe recorded",
    "stale": "frames refused: too old",
    "repeated": "frames refused: repeated",
    "reordered": "frames refused: out of order",
    "candidates": "frames refused: do not follow the last one",
    "missed": "frames missed",
    "adopted": "times connected",
    "lost": "times lost",
    "sent": "frames sent",
    "connects": "openings of the port",
    "noise_bytes": "bytes outside frames",
    "other_senders": "datagrams from other addresses",
    "segments": "path points sent",
    "dropped": "frames dropped: backlog",
    "telemetry_shed": "frames not published: backlog",
}


class SessionHealth(ABC):
    """Health of a partner since the last call; subclasses add values of their kind of partner.

    Args:
        session: with the partner.
        transport: to it.
        signed: whether frames are signed.
    """

    firmware: int  # slow field of its version

    def __init__(self, session: Session[Any], transport: Transport, signed: bool) -> None:
        self.session, self.transport, self.signed = session, transport, signed
        self.counts, self.last_time = dict(session.counts), 0

    @abstractmethod
    def values(self) -> Mapping[str, Any]:
        """Return the values of this kind of partner."""

    @abstractmethod
    def is_healthy(self) -> bool:
        """Return True if the words describe nothing to warn of."""

    def warnings(self, increase: Mapping[str, int]) -> Iterator[str]:
        """Yield warnings, the most severe first; an empty one is none.

        `increase` is that of each count since the last call.
        """
        yield self.session.link_problem
        if (left := self.session.battery.time_left()) < BATTERY_WARNING_TIME:
            yield f"the battery lasts {left / 60.0:.0f} min"
        if any(increase[name] for name in FRAME_PROBLEMS):
            yield "frames were lost or rejected"

    def __call__(self, now: int, more: Mapping[str, Any] | None = None) -> Health:
        """Return the diagnostic status at time `now` [ns], with the values of `more` added."""
        session, before, last_time = self.session, self.counts, self.last_time
        session.tick(now)
        self.counts, self.last_time = dict(session.counts), now
        increase = {name: count - before[name] for name, count in self.counts.items()}
        values = {
            "state": session.arming.value,
            **self.values(),
            **self._common(increase, (now - last_time) / SECOND, now),
            **(more or {}),
        }
        if now == last_time:
            return Health(WARN, "the clock is stopped: does /clock advance?", values)
        if session.lost:
            why = (
                self.transport.problem
                or session.other_driver
                or session.link_problem
                or session.loss_reason
            )
            return Health(ERROR, f"{session.partner.label} is lost{': ' * bool(why)}{why}", values)
        words = session.describe_state()
        if session.other_driver or session.faults:
            return Health(ERROR, session.other_driver or words, values)
        if warning := next(filter(None, self.warnings(increase)), ""):
            return Health(WARN, f"{words}; {warning}", values)
        return Health(OK if self.is_healthy() else WARN, words, values)

    def _common(self, increase: Mapping[str, int], seconds: float, now: int) -> dict[str, Any]:
        session, firmware = self.session, self.session.slow.get(self.firmware, 0)
        expected = increase["accepted"] + increase["missed"]
        loss = 100.0 * increase["missed"] / expected if expected else 0.0
        return {
            "rate [1/s]": increase["accepted"] / seconds if seconds else 0.0,
            "loss since the last message [%]": loss,
            "age [s]": session.silence(now),
            "round trip [s]": session.round_trip,
            "clock offset [s]": session.offset,
            "clock drift [ppm]": 1e6 * session.drift,
            "clock deviation [s]": session.deviation(now),
            "battery [V]": session.battery.voltage,
            "battery lasts [min]": session.battery.time_left() / 60.0,
            "firmware": f"{firmware >> 16}.{firmware >> 8 & 0xFF}.{firmware & 0xFF}",
            "signed": self.signed,
            **counters(self.counts),
            **counters(self.transport.counts),
        }


def counters(counts: Mapping[str, int]) -> dict[str, int]:
    """Return counts by their names in diagnostics."""
    return {COUNTER_NAMES.get(name, name.replace("_", " ")): n for name, n in counts.items()}
