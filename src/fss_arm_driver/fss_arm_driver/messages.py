"""Conversion between a link's session and messages."""

from collections.abc import Iterator, Mapping
from math import nan
from typing import Any

from builtin_interfaces.msg import Time
from sensor_msgs.msg import BatteryState, JointState

from fss_arm_driver.faults import active_faults
from fss_arm_driver.protocol import NO_TORQUE, Slow
from fss_arm_driver.session import LinkSession, Report, Sample
from fss_arm_msgs.msg import CommandStatus, LinkCommand, LinkTelemetry
from fss_arm_ros.convert import SECOND, to_time
from fss_link.health import SessionHealth
from fss_link.messages import battery_state, set_telemetry
from fss_link.session import CommandError

MILLISECOND = 1_000_000  # [ns]
#: Fields that a LinkTelemetry copies from the frame; below, those sent in turn.
REPORTED = (
    *("boot", "sequence", "clock", "position", "velocity", "current"),
    *("torque", "torque_age", "mode", "flags", "status"),
)
UNREPORTED = Slow.TEMPERATURE, Slow.PATH, Slow.SERIAL  # handled separately
SLOW_NAMES = tuple((int(s), s.name.lower()) for s in Slow if s not in UNREPORTED)
MAX_TIME_TO_LIVE = 3600.0  # of a command [s]


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
        set_telemetry(message, frame, session, now, REPORTED, SLOW_NAMES)
        message.path = session.path
        message.temperature = session.slow.get(Slow.TEMPERATURE, 0)
        has_torque = frame.torque_age < NO_TORQUE
        _set(message.torque_stamp, (sample.stamp - frame.torque_age * MILLISECOND) * has_torque)
        return message

    def battery(self, sample: Sample) -> BatteryState:
        """Return the state of the link's battery."""
        voltage, frame_id = self.session.battery.voltage, self._telemetry.header.frame_id
        return battery_state(sample.stamp, voltage, frame_id)


def _set(stamp: Time, ns: int) -> None:
    stamp.sec, stamp.nanosec = divmod(ns, SECOND)


def command_status(report: Report, now: int) -> CommandStatus:
    """Return a report as a message; `now` is the time of day [ns]."""
    message = CommandStatus(status=int(report.status), reason=report.reason)
    message.header.stamp, message.given = to_time(now), to_time(report.given)
    return message


def command_values(message: LinkCommand, given: int) -> tuple[int, float, float, float, int]:
    """Return mode, value, largest velocity and acceleration, and expiry, for `LinkSession.set`.

    Args:
        message: the command.
        given: when it was given, in the session's clock [ns].

    Raises:
        CommandError: its time to live is not valid.
    """
    if not 0.0 < (lives := message.time_to_live) <= MAX_TIME_TO_LIVE:
        raise CommandError(f"time_to_live is {lives} s, expected above 0")
    value = message.path if message.mode == LinkCommand.PATH else message.set_point
    expiry = given + round(lives * SECOND)
    return message.mode, value, message.max_velocity, message.max_acceleration, expiry


class LinkHealth(SessionHealth):
    """Health of a link since the last call."""

    session: LinkSession
    firmware = Slow.FIRMWARE

    def warnings(self, increase: Mapping[str, int]) -> Iterator[str]:
        """Yield warnings; the first is that an expected serial number was not reported."""
        yield self.session.serial_problem
        yield from super().warnings(increase)

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
