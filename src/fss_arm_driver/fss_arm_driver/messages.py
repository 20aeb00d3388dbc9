"""What a link's session knows, as messages."""

from math import nan
from typing import Any

from builtin_interfaces.msg import Time
from sensor_msgs.msg import BatteryState, JointState

from fss_arm_driver.faults import present
from fss_arm_driver.health import SessionHealth
from fss_arm_driver.protocol import NO_TORQUE, Slow, State
from fss_arm_driver.session import LinkSession, Progress, Sample, Status
from fss_arm_driver.transport import Transport
from fss_arm_msgs.msg import CommandStatus, LinkTelemetry
from fss_arm_ros.convert import SECOND, to_time

MILLISECOND = 1_000_000  # [ns]
#: What a LinkTelemetry has as the frame has it, and what took turns in the frames.
REPORTED = (
    *("boot", "sequence", "clock", "position", "velocity", "current"),
    *("torque", "torque_age", "mode", "flags", "status"),
)
UNREPORTED = Slow.TEMPERATURE, Slow.PATH, Slow.SERIAL  # as the others are
SLOW_NAMES = tuple((int(s), s.name.lower()) for s in Slow if s not in UNREPORTED)
LATCHED_WORDS = {
    State.STOPPED: "the link is stopped",
    State.WATCHDOG: "its watchdog tripped",
    State.BROKEN: "its last path broke off",
}


class SampleMessages:
    """A link's samples as messages.

    Each message is made once and filled anew for each sample, as making one costs more than
    publishing it: what is returned holds until the next sample.
    """

    def __init__(self, session: LinkSession, frame_prefix: str = "") -> None:
        self.session = session
        name = [f"joint_{session.number}"]
        self._joint_state = JointState(name=name, position=[nan], velocity=[nan], effort=[nan])
        self._telemetry = LinkTelemetry(link=session.number)
        self._telemetry.header.frame_id = f"{frame_prefix}link_{session.number}"

    def joint_state(self, sample: Sample) -> JointState:
        """The joint's state at the time of the measurement."""
        message = self._joint_state
        _set(message.header.stamp, sample.stamp)
        message.position[0] = sample.position
        message.velocity[0] = sample.velocity
        message.effort[0] = sample.torque
        return message

    def telemetry(self, sample: Sample, now: int) -> LinkTelemetry:
        """Everything that the link reported, raw, and what the session knows of it."""
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
        """The link's battery, of which only the voltage is known."""
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
    """How far a command has come."""
    message = CommandStatus(status=int(progress.status), reason=progress.reason)
    message.header.stamp, message.given = to_time(now), to_time(given)
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


class LinkHealth(SessionHealth):
    """A link's health since it was last asked for."""

    session: LinkSession
    firmware = Slow.FIRMWARE

    def __init__(self, session: LinkSession, transport: Transport, signed: bool) -> None:
        super().__init__(f"link_{session.number}", session, transport, signed)

    def words(self) -> str:
        """How the link is, for people."""
        return state_words(self.session)

    def doubt(self) -> str:
        """That it has told no serial number where one is expected."""
        return self.session.nameless

    def is_well(self) -> bool:
        """Whether its positions mean something."""
        return self.session.referenced

    def values(self) -> dict[str, Any]:
        """What the drive reports."""
        session, slow = self.session, self.session.slow
        known = [f.name for f in present(session.frame.status, 0)] if session.frame else []
        return {
            "faults": ", ".join(session.faults) or "none",
            "drive": ", ".join(known) or "nothing to report",
            "referenced": session.referenced,
            "homings": slow.get(Slow.HOMINGS, 0),
            "supply [V]": 0.1 * slow[Slow.SUPPLY] if Slow.SUPPLY in slow else "not reported",
            "temperature [deg C]": slow.get(Slow.TEMPERATURE, "not reported"),
            "serial": slow.get(Slow.SERIAL, "not told yet"),
            "expected serial": session.serial or "any",
        }
