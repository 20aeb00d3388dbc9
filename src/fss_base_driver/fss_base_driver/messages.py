"""Conversion of what the board and motion capture report to messages."""

from collections.abc import Iterator, Mapping, Sequence
from math import nan
from typing import Any

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import BatteryState, FluidPressure, Imu
from std_msgs.msg import Float64

from fss_arm_model.thrusters import gas_mass
from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand
from fss_arm_ros.convert import to_time
from fss_base_driver.mocap import Pose
from fss_base_driver.protocol import VALVES, BaseSlow, BaseState, GripperFlag
from fss_base_driver.session import BoardSample, BoardSession
from fss_base_driver.settings import BaseSettings
from fss_link.health import SessionHealth
from fss_link.messages import battery_state, set_telemetry

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
#: Types of the messages that a node `base` publishes, by topic.
TOPICS = {
    "thrusters/pulses": ThrusterCommand,
    "base/telemetry": BaseTelemetry,
    "gripper/state": GripperState,
    "base/battery": BatteryState,
    "base/pressure": FluidPressure,
    "base/propellant": Float64,
}


def frame_messages(
    sample: BoardSample, session: BoardSession, now: int, settings: BaseSettings
) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of all values in a frame, except the gyro's rate.

    Args:
        sample: the frame, with the time of day of its measurement.
        session: its session.
        now: the time [ns].
        settings: frames of reference, and the tank's volume.
    """
    stamp, frame, frame_id = sample.stamp, sample.frame, settings.base_frame
    yield "base/telemetry", telemetry(sample, session, now, frame_id)
    yield "gripper/state", gripper_state(sample, f"{settings.frame_prefix}end_effector")
    if frame.slow_id == BaseSlow.BATTERY:
        yield "base/battery", battery_state(stamp, session.battery.voltage, frame_id)
    if frame.slow_id == BaseSlow.TANK:
        yield "base/pressure", pressure(stamp, frame.slow_value, frame_id)
        if left := propellant(session.slow, settings.tank_volume):
            yield "base/propellant", left


def telemetry(sample: BoardSample, session: BoardSession, now: int, frame_id: str) -> BaseTelemetry:
    """Return all that the board reported, raw, with the state of the session."""
    message, slow = BaseTelemetry(), session.slow
    message.header.stamp, message.header.frame_id = to_time(sample.stamp), frame_id
    set_telemetry(message, sample.frame, session, now, REPORTED, SLOW_NAMES)
    message.temperature = slow.get(BaseSlow.TEMPERATURE, 0)
    message.open = [slow.get(BaseSlow.OPEN_1 + i, 0) & 0xFFFFFFFF for i in range(VALVES)]
    return message


def imu(stamp: int, rate: float, deviation: float, frame_id: str) -> Imu:
    """Return a turn rate about z with its standard deviation [rad/s]."""
    message = Imu()
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    message.orientation_covariance[0] = message.linear_acceleration_covariance[0] = -1.0
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = deviation**2
    return message


def pose_stamped(stamp: int, frame_id: str, pose: Pose) -> PoseStamped:
    """Return a pose in space: x, y, z [m], quaternion x, y, z, w."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    at, turn = message.pose.position, message.pose.orientation
    at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = pose
    return message


def gripper_state(sample: BoardSample, frame_id: str) -> GripperState:
    """Return the gripper's state; the board knows neither distance nor angle to anything."""
    state = sample.frame.gripper
    message = GripperState(
        closed=bool(state & GripperFlag.COMMANDED_CLOSED),
        holds=bool(state & GripperFlag.HOLDS),
        distance=nan,
        angle=nan,
        speed=nan,
    )
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


def propellant(slow: dict[int, int], volume: float) -> Float64 | None:
    """Return the remaining mass of gas [kg], once pressure and temperature are known."""
    if not {BaseSlow.TANK, BaseSlow.TEMPERATURE} <= slow.keys():
        return None
    kelvins = ZERO_CELSIUS + 0.1 * slow[BaseSlow.TEMPERATURE]
    if kelvins <= 0.0:
        return None
    return Float64(data=gas_mass(KILOPASCAL * slow[BaseSlow.TANK], volume, kelvins))


class BoardHealth(SessionHealth):
    """Health of the board since the last report."""

    session: BoardSession
    firmware = BaseSlow.FIRMWARE

    def warnings(self, increase: Mapping[str, int]) -> Iterator[str]:
        """Yield warnings; the last is that the valves cannot produce the wrench."""
        yield from super().warnings(increase)
        if increase["wrenches_clipped"]:
            yield "base/wrench exceeds the thrust of the valves"

    def is_healthy(self) -> bool:
        """Return True if nothing is latched and the currents of all valves match their commands."""
        flagged = self.session.frame and self.session.frame.flags & ~BaseState.ARMED
        return not flagged and not self.session.remarks

    def values(self) -> dict[str, Any]:
        """Return the values reported by the board's instruments."""
        slow = self.session.slow

        def reported(field: BaseSlow, unit: float = 1) -> Any:
            return unit * slow[field] if field in slow else "not reported"

        return {
            "valves' faults": ", ".join(self.session.remarks) or "none",
            "remaining opening time of the valves [s]": reported(BaseSlow.LEFT, 1e-3),
            "tank [kPa]": reported(BaseSlow.TANK),
            "supply [kPa]": reported(BaseSlow.SUPPLY, 0.1),
            "refused by the board": reported(BaseSlow.REFUSED),
        }
