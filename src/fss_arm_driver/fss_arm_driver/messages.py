"""What a link's session knows, as messages."""

from typing import Any

from sensor_msgs.msg import JointState

from fss_arm_driver.faults import present
from fss_arm_driver.link import NO_TORQUE, TROUBLES, LinkSession, Sample
from fss_arm_driver.progress import Progress, Status
from fss_arm_driver.protocol import Slow, State
from fss_arm_driver.transport import Transport
from fss_arm_msgs.msg import CommandStatus, LinkTelemetry
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Health

MILLISECOND = 1_000_000  # [ns]
LATCHED_WORDS = {State.STOPPED: "the link is stopped", State.WATCHDOG: "its watchdog tripped"}


def joint_state(number: int, sample: Sample) -> JointState:
    """A sample as the joint's state at the time of the measurement."""
    message = JointState(
        name=[f"joint_{number}"],
        position=[sample.position],
        velocity=[sample.velocity],
        effort=[sample.torque],
    )
    message.header.stamp = to_time(sample.stamp)
    return message


def telemetry(sample: Sample) -> LinkTelemetry:
    """A sample with everything that the link reported, raw."""
    frame, slow = sample.frame, sample.slow
    message = LinkTelemetry(
        link=frame.link,
        boot=frame.boot,
        sequence=frame.sequence,
        clock=frame.clock,
        clock_deviation=sample.deviation,
        round_trip=sample.round_trip,
        position=frame.position,
        velocity=frame.velocity,
        current=frame.current,
        torque=frame.torque,
        torque_age=frame.torque_age,
        mode=frame.mode,
        flags=frame.flags,
        status=frame.status,
        temperature=slow.get(Slow.TEMPERATURE, 0),
        armed=sample.armed,
        **{
            field.name.lower(): slow.get(field, 0) & 0xFFFFFFFF
            for field in Slow
            if field is not Slow.TEMPERATURE
        },
    )
    message.header.stamp = to_time(sample.stamp)
    message.header.frame_id = f"link_{frame.link}"
    if frame.torque_age < NO_TORQUE:
        message.torque_stamp = to_time(sample.stamp - frame.torque_age * MILLISECOND)
    return message


def command_status(progress: Progress, now: int) -> CommandStatus:
    """How far a command has come."""
    message = CommandStatus(status=int(progress.status), reason=progress.reason)
    message.header.stamp, message.given = to_time(now), to_time(progress.given)
    return message


def command_refused(reason: str, given: int, now: int) -> CommandStatus:
    """A command that was not taken."""
    message = CommandStatus(status=int(Status.REFUSED), reason=reason)
    message.header.stamp, message.given = to_time(now), to_time(given)
    return message


def state_words(session: LinkSession) -> str:
    """How the link is, for people."""
    flags = session.frame.flags if session.frame else 0
    words = [text for latch, text in LATCHED_WORDS.items() if flags & latch]
    words += session.faults
    if session.frame and not session.referenced:
        words.append("not referenced")
    state = f"link_{session.number} is {session.arming.value}"
    return f"{state}: {', '.join(words)}" if words else state


class LinkHealth:
    """A link's health since it was last asked for."""

    def __init__(self, session: LinkSession, transport: Transport, signed: bool) -> None:
        self.session, self.transport, self.signed = session, transport, signed
        self.counts, self.then = dict(session.counts), 0

    def __call__(self, now: int) -> Health:
        """How the link is at `now` [ns]."""
        session, before, then = self.session, self.counts, self.then
        session.tick(now)
        self.counts, self.then = dict(session.counts), now
        grown = {name: count - before[name] for name, count in self.counts.items()}
        values = self._values(grown, (now - then) / SECOND, now)
        words = state_words(session)
        if now == then:
            return Health(WARN, "the clock stands still", values)
        if session.lost:
            why = self.transport.trouble
            return Health(ERROR, f"link_{session.number} is lost{': ' * bool(why)}{why}", values)
        if session.faults:
            return Health(ERROR, words, values)
        if any(grown[name] for name in TROUBLES):
            return Health(WARN, f"{words}; frames were lost or refused", values)
        return Health(OK if session.referenced else WARN, words, values)

    def _values(self, grown: dict[str, int], seconds: float, now: int) -> dict[str, Any]:
        session, slow = self.session, self.session.slow
        came = grown["believed"] + grown["missed"]
        firmware = slow.get(Slow.FIRMWARE, 0)
        known = [f.name for f in present(session.frame.status, 0)] if session.frame else []
        return {
            "state": session.arming.value,
            "faults": ", ".join(session.faults) or "none",
            "drive": ", ".join(known) or "nothing to report",
            "referenced": session.referenced,
            "homings": slow.get(Slow.HOMINGS, 0),
            "rate [1/s]": grown["believed"] / seconds if seconds else 0.0,
            "loss [%]": 100.0 * grown["missed"] / came if came else 0.0,
            "age [s]": session.silence(now),
            "round trip [s]": session.round_trip,
            "clock offset [s]": session.offset,
            "clock drift [ppm]": 1e6 * session.drift,
            "clock deviation [s]": session.deviation(now),
            "supply [V]": 0.1 * slow[Slow.SUPPLY] if Slow.SUPPLY in slow else "not reported",
            "battery [V]": session.battery.voltage,
            "battery lasts [min]": session.battery.time_left() / 60.0,
            "temperature [deg C]": slow.get(Slow.TEMPERATURE, "not reported"),
            "firmware": f"{firmware >> 16}.{firmware >> 8 & 0xFF}.{firmware & 0xFF}",
            "signed": self.signed,
            **self.counts,
            **self.transport.counts,
        }
