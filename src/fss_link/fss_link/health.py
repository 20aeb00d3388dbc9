"""Diagnostic status of a session with a link or the base's board."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any

from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Health
from fss_link.session import TROUBLES, Session
from fss_link.transport import Transport

SHORT = 600.0  # remaining battery time below which to warn [s]


class SessionHealth(ABC):
    """Health of a partner since the last call; subclasses add values of their kind of partner.

    Args:
        name: of the partner, in words.
        session: with it.
        transport: to it.
        signed: whether frames are signed.
    """

    firmware: int  # slow field of its version

    def __init__(
        self, name: str, session: Session[Any], transport: Transport, signed: bool
    ) -> None:
        self.name, self.session, self.transport, self.signed = name, session, transport, signed
        self.counts, self.then = dict(session.counts), 0

    @abstractmethod
    def words(self) -> str:
        """Return the partner's state in words."""

    @abstractmethod
    def values(self) -> Mapping[str, Any]:
        """Return the values of this kind of partner."""

    @abstractmethod
    def is_well(self) -> bool:
        """Return True if the words describe nothing to warn of."""

    def doubt(self) -> str:
        """Return a further warning in words; empty: none."""
        return ""

    def __call__(self, now: int, more: Mapping[str, Any] | None = None) -> Health:
        """Return the diagnostic status at time `now` [ns], with the values of `more` added."""
        session, before, then = self.session, self.counts, self.then
        session.tick(now)
        self.counts, self.then = dict(session.counts), now
        grown = {name: count - before[name] for name, count in self.counts.items()}
        values = {
            "state": session.arming.value,
            **self.values(),
            **self._common(grown, (now - then) / SECOND, now),
            **(more or {}),
        }
        if now == then:
            return Health(WARN, "the clock stands still", values)
        if session.lost:
            why = self.transport.trouble or session.rival or session.strain or session.absence
            return Health(ERROR, f"{self.name} is lost{': ' * bool(why)}{why}", values)
        words = self.words()
        if session.rival or session.faults:
            return Health(ERROR, session.rival or words, values)
        if doubt := next(filter(None, self._doubts(grown)), ""):
            return Health(WARN, f"{words}; {doubt}", values)
        return Health(OK if self.is_well() else WARN, words, values)

    def _doubts(self, grown: Mapping[str, int]) -> Iterator[str]:
        """Yield warnings, the most severe first; an empty one is none."""
        yield self.doubt()
        yield self.session.strain
        if (left := self.session.battery.time_left()) < SHORT:
            yield f"the battery lasts {left / 60.0:.0f} min"
        if any(grown[name] for name in TROUBLES):
            yield "frames were lost or refused"

    def _common(self, grown: Mapping[str, int], seconds: float, now: int) -> dict[str, Any]:
        session, firmware = self.session, self.session.slow.get(self.firmware, 0)
        came = grown["believed"] + grown["missed"]
        return {
            "rate [1/s]": grown["believed"] / seconds if seconds else 0.0,
            "loss [%]": 100.0 * grown["missed"] / came if came else 0.0,
            "age [s]": session.silence(now),
            "round trip [s]": session.round_trip,
            "clock offset [s]": session.offset,
            "clock drift [ppm]": 1e6 * session.drift,
            "clock deviation [s]": session.deviation(now),
            "battery [V]": session.battery.voltage,
            "battery lasts [min]": session.battery.time_left() / 60.0,
            "firmware": f"{firmware >> 16}.{firmware >> 8 & 0xFF}.{firmware & 0xFF}",
            "signed": self.signed,
            **self.counts,
            **self.transport.counts,
        }
