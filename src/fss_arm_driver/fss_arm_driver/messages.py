"""Believed telemetry as messages."""

from sensor_msgs.msg import JointState

from fss_arm_driver.link import Sample
from fss_arm_driver.protocol import Slow
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import to_time

MILLISECOND = 1_000_000  # [ns]
OR_OLDER = 255  # as the age of a torque sample [ms]


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
    if frame.torque_age < OR_OLDER:
        message.torque_stamp = to_time(sample.stamp - frame.torque_age * MILLISECOND)
    return message
