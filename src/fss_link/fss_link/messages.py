"""Conversion of telemetry that links and board have in common to messages."""

from collections.abc import Iterable
from math import nan
from typing import Any

from sensor_msgs.msg import BatteryState

from fss_arm_ros.convert import to_time
from fss_link.protocol import TelemetryHead
from fss_link.session import Session


def set_telemetry(
    message: Any,
    frame: TelemetryHead,
    session: Session[Any],
    now: int,
    copied: Iterable[str],
    slow_names: Iterable[tuple[int, str]],
) -> None:
    """Set the fields of a LinkTelemetry or BaseTelemetry that are raw or the session's state.

    `copied` are the fields to copy from the frame, `slow_names` the slow fields: number and name.
    """
    for name in copied:
        setattr(message, name, getattr(frame, name))
    for field, name in slow_names:
        setattr(message, name, session.slow.get(field, 0) & 0xFFFFFFFF)
    message.clock_deviation = session.deviation(now)
    message.round_trip = session.round_trip
    message.armed = session.armed


def battery_state(stamp: int, voltage: float, frame_id: str) -> BatteryState:
    """Return the state of a battery of which only the voltage [V] is known."""
    message = BatteryState(
        voltage=voltage,
        temperature=nan,
        current=nan,
        charge=nan,
        capacity=nan,
        design_capacity=nan,
        percentage=nan,
        present=True,
        location=frame_id,
    )
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message
