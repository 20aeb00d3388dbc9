"""Conversion of the state of the board's session to messages."""

from collections.abc import Iterator, Mapping, Sequence
from math import nan
from typing import Any

from sensor_msgs.msg import BatteryState, FluidPressure, Imu
from std_msgs.msg import Float64

from fss_arm_model.thrusters import gas_mass
from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand
from fss_arm_ros.convert import to_time
from fss_base_driver.protocol import VALVES, BaseSlow, BaseState, GripperFlag
from fss_base_driver.session import BoardSample, BoardSession
from fss_link.health import SessionHealth
from fss_link.transport import Transport

ZERO_CELSIUS = 273.15  # [K]
KILOPASCAL = 1e3  # [Pa]
#: Fields that a BaseTelemetry copies from the frame, and those that frames send in turn.
REPORTED = (
    *("boot", "sequence", "clock", "gyro_sum", "gyro_samples", "valves", "gripper"),
    *("pulse", "pulse_age", "flags"),
)
SLOW_NAMES = tuple(
    (int(s), s.name.lower())
    for s in BaseSlow
    if s is not BaseSlow.TEMPERATURE and s < BaseSlow.OPEN_1
)
FLAG_WORDS = {
    BaseState.STOPPED: "it is stopped",
    BaseState.WATCHDOG: "its watchdog tripped",
    BaseState.SPENT: "its valves' total time is used up",
    BaseState.LIMITED: "a valve was closed by a limit",
}


def telemetry(sample: BoardSample, session: BoardSession, now: int, frame_id: str) -> BaseTelemetry:
    """Return all that the board reported, raw, with the state of the session."""
    message, slow = BaseTelemetry(), session.slow
    message.header.stamp, message.header.frame_id = to_time(sample.stamp), frame_id
    for name in REPORTED:
        setattr(message, name, getattr(sample.frame, name))
    for field, name in SLOW_NAMES:
        setattr(message, name, slow.get(field, 0) & 0xFFFFFFFF)
    message.temperature = slow.get(BaseSlow.TEMPERATURE, 0)
    message.open = [slow.get(BaseSlow.OPEN_1 + i, 0) & 0xFFFFFFFF for i in range(VALVES)]
    message.clock_deviation = session.deviation(now)
    message.round_trip = session.round_trip
    message.armed = session.armed
    return message


def imu(stamp: int, rate: float, deviation: float, frame_id: str) -> Imu:
    """Return a turn rate about z with its standard deviation [rad/s]."""
    message = Imu()
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    message.orientation_covariance[0] = message.linear_acceleration_covariance[0] = -1.0
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = deviation**2
    return message


def gripper_state(sample: BoardSample, frame_id: str) -> GripperState:
    """Return the gripper's state; the board knows neither distance nor angle to anything."""
    state = sample.frame.gripper
    message = GripperState(
        closed=bool(state & GripperFlag.COMMANDED_CLOSED), holds=bool(state & GripperFlag.HOLDS),
        distance=nan, angle=nan, speed=nan,
    )  # fmt: skip
    message.header.stamp, message.header.frame_id = to_time(sample.stamp), frame_id
    return message


def pulses(stamp: int, on_times: Sequence[float]) -> ThrusterCommand:
    """Return the commanded on-times of the valves [s]."""
    message = ThrusterCommand(on_time=list(on_times))
    message.header.stamp = to_time(stamp)
    return message


def pressure(stamp: int, kilopascals: int, frame_id: str) -> FluidPressure:
    """Return the pressure of the tank."""
    message = FluidPressure(fluid_pressure=KILOPASCAL * kilopascals, variance=0.0)
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message


def battery(stamp: int, voltage: float, frame_id: str) -> BatteryState:
    """Return the state of the board's battery, of which only the voltage is known."""
    message = BatteryState(
        voltage=voltage, temperature=nan, current=nan, charge=nan, capacity=nan,
        design_capacity=nan, percentage=nan, present=True, location=frame_id,
    )  # fmt: skip
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message


def propellant(slow: dict[int, int], volume: float) -> Float64 | None:
    """Return the remaining mass of gas [kg], once pressure and temperature are known."""
    if not {BaseSlow.TANK, BaseSlow.TEMPERATURE} <= slow.keys():
        return None
    kelvins = ZERO_CELSIUS + 0.1 * slow[BaseSlow.TEMPERATURE]
    if kelvins <= 0.0:
        return None
    return Float64(data=gas_mass(KILOPASCAL * slow[BaseSlow.TANK], volume, kelvins))


def faulty_valves(slow: dict[int, int]) -> list[str]:
    """Return the valves whose current does not match their command."""
    bits = slow.get(BaseSlow.FAULTS, 0)
    dead = [f"valve {i + 1} draws no current" for i in range(VALVES) if bits >> i & 1]
    live = [
        f"valve {i + 1} draws current without a command" for i in range(VALVES) if bits >> i + 8 & 1
    ]
    return dead + live


def describe_state(session: BoardSession) -> str:
    """Return the board's state as text."""
    flags = session.frame.flags if session.frame else 0
    words = [text for flag, text in FLAG_WORDS.items() if flags & flag]
    words += faulty_valves(session.slow)
    state = f"{session.partner.name} is {session.arming.value}"
    return f"{state}: {', '.join(words)}" if words else state


class BoardHealth(SessionHealth):
    """Health of the board since the last report."""

    session: BoardSession
    firmware = BaseSlow.FIRMWARE

    def __init__(self, session: BoardSession, transport: Transport, signed: bool) -> None:
        super().__init__(session.partner.name, session, transport, signed)

    def describe_state(self) -> str:
        """Return the board's state as text."""
        return describe_state(self.session)

    def _warnings(self, grown: Mapping[str, int]) -> Iterator[str]:
        """Yield warnings, the most serious first."""
        yield from super()._warnings(grown)
        if grown["wrenches_clipped"]:
            yield "base/wrench exceeds the thrust of the valves"

    def is_healthy(self) -> bool:
        """Return True if nothing is latched and the currents of all valves match their commands."""
        flagged = self.session.frame and self.session.frame.flags & ~BaseState.ARMED
        return not flagged and not faulty_valves(self.session.slow)

    def values(self) -> dict[str, Any]:
        """Return the values reported by the board's instruments."""
        slow = self.session.slow
        return {
            "valves' faults": ", ".join(faulty_valves(slow)) or "none",
            "valves' time left [s]": 1e-3 * slow.get(BaseSlow.LEFT, 0),
            "tank [kPa]": slow.get(BaseSlow.TANK, "not reported"),
            "supply [kPa]": 0.1 * slow[BaseSlow.SUPPLY] if BaseSlow.SUPPLY in slow else nan,
            "refused by the board": slow.get(BaseSlow.REFUSED, 0),
        }
