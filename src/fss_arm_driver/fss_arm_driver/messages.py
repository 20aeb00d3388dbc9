"""Conversion of a link's session to messages."""

from math import nan
from typing import Any

from builtin_interfaces.msg import Time
from sensor_msgs.msg import BatteryState, JointState

from fss_arm_driver.faults import active_faults
from fss_arm_driver.protocol import NO_TORQUE, Slow, State
from fss_arm_driver.session import LinkSession, Progress, Sample, Status
from fss_arm_msgs.msg import CommandStatus, LinkTelemetry
from fss_arm_ros.convert import SECOND, to_time
from fss_link.health import SessionHealth
from fss_link.transport import Transport

MILLISECOND = 1_000_000  # [ns]
#: Fields that a LinkTelemetry copies from the frame; below, those sent in turn.
REPORTED = (
    *("boot", "sequence", "clock", "position", "velocity", "current"),
    *("torque", "torque_age", "mode", "flags", "status"),
)
UNREPORTED = Slow.TEMPERATURE, Slow.PATH, Slow.SERIAL  # handled separately
SLOW_NAMES = tuple((int(s), s.name.lower()) for s in Slow if s not in UNREPORTED)
LATCHED_WORDS = {
    State.STOPPED: "the link is stopped",
    State.WATCHDOG: "its watchdog tripped",
    State.BROKEN: "its last path was aborted",
}


class SampleMessages:
    """Converter of a link's samples to messages.

    Each message is created once and reused for each sample, because creation costs more than
    publication: a returned message is valid until the next sample.
    """

    def __init__(self, session: LinkSession, frame_prefix: str = "") -> None:
        self.session = session
        name = [f"joint_{session.number}"]
        self._joint_state = JointState(name=name, position=[nan], velocity=[nan], effort=[nan])
        self._telemetry = LinkTelemetry(link=session.number)
        self._telemetry.header.frame_id = f"{frame_prefix}link_{session.number}"

    def joint_state(self, sample: Sample) -> JointState:
        """Return the joint's state at the time of the measurement."""
        message = self._joint_state
        _set(message.header.stamp, sample.stamp)
        message.position[0] = sample.position
        message.velocity[0] = sample.velocity
        message.effort[0] = sample.torque
        return message

    def telemetry(self, sample: Sample, now: int) -> LinkTelemetry:
        """Return all raw values that the link reported, and the session's state."""
        message, frame, session = self._telemetry, sample.frame, self.session
        _set(message.header.stamp, sample.stamp)
        for name in REPORTED:
            setattr(message, name, getattr(frame, name))
        for field, name in SLOW_NAMES:
            setattr(message, name, session.slow.get(field, 0) & 0xFFFFFFFF)
        message.path = session.path
        message.temperature = session.slow.get(Slow.TEMPERATURE, 0)
        message.clock_deviation = session.deviation(now)
        message.round_trip = session.round_trip
        message.armed = session.armed
        has_torque = frame.torque_age < NO_TORQUE
        _set(message.torque_stamp, (sample.stamp - frame.torque_age * MILLISECOND) * has_torque)
        return message

    def battery(self, sample: Sample) -> BatteryState:
        """Return the state of the link's battery, of which only the voltage is known."""
        message = BatteryState(
            voltage=self.session.battery.voltage, temperature=nan, current=nan, charge=nan,
            capacity=nan, design_capacity=nan, percentage=nan, present=True,
            location=self._telemetry.header.frame_id,
        )  # fmt: skip
        _set(message.header.stamp, sample.stamp)
        message.header.frame_id = message.location
        return message


def _set(stamp: Time, ns: int) -> None:
    stamp.sec, stamp.nanosec = divmod(ns, SECOND)


def command_status(progress: Progress, given: int, now: int) -> CommandStatus:
    """Return the progress of a command as a message."""
    message = CommandStatus(status=int(progress.status), reason=progress.reason)
    message.header.stamp, message.given = to_time(now), to_time(given)
    return message


def command_refused(reason: str, given: int, now: int) -> CommandStatus:
    """Return the status of a refused command as a message."""
    message = CommandStatus(status=int(Status.REFUSED), reason=reason)
    message.header.stamp, message.given = to_time(now), to_time(given)
    return message


def describe_state(session: LinkSession) -> str:
    """Return the link's state in words."""
    flags = session.frame.flags if session.frame else 0
    words = [text for latch, text in LATCHED_WORDS.items() if flags & latch]
    words += session.faults
    if session.frame and not session.referenced:
        words.append("not referenced")
    state = f"link_{session.number} is {session.arming.value}"
    return f"{state}: {', '.join(words)}" if words else state


class LinkHealth(SessionHealth):
    """Health of a link since the last call."""

    session: LinkSession
    firmware = Slow.FIRMWARE

    def __init__(self, session: LinkSession, transport: Transport, signed: bool) -> None:
        super().__init__(f"link_{session.number}", session, transport, signed)

    def describe_state(self) -> str:
        """Return the link's state in words."""
        return describe_state(self.session)

    def extra_warning(self) -> str:
        """Return a warning if the link has not reported an expected serial number."""
        return self.session.serial_problem

    def is_healthy(self) -> bool:
        """Return True if the link's positions are valid."""
        return self.session.referenced

    def values(self) -> dict[str, Any]:
        """Return the values that the drive reports."""
        session, slow = self.session, self.session.slow
        known = [f.name for f in active_faults(session.frame.status, 0)] if session.frame else []
        return {
            "faults": ", ".join(session.faults) or "none",
            "drive": ", ".join(known) or "nothing to report",
            "referenced": session.referenced,
            "homings": slow.get(Slow.HOMINGS, 0),
            "supply [V]": 0.1 * slow[Slow.SUPPLY] if Slow.SUPPLY in slow else "not reported",
            "temperature [deg C]": slow.get(Slow.TEMPERATURE, "not reported"),
            "serial": slow.get(Slow.SERIAL, "not reported yet"),
            "expected serial": session.serial or "any",
        }
