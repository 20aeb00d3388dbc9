"""Messages of the test bed, made fast enough for ten times real time."""

from collections.abc import Sequence
from math import cos, inf, sin
from struct import pack_into
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from fss_arm_msgs.msg import GripperState, SimTruth
from fss_arm_ros.convert import SECOND, TURN_RATE, pose_stamped, to_time
from fss_sim.plant.bed import Bed, Clearance
from fss_sim.plant.vehicle import Vehicle
from fss_sim.sensors import SubjectReading

STAMP = 4  # offset of the stamp, after CDR's encapsulation header [bytes]
DOUBLE = 8  # [bytes]
EDGE_NAME = "table edge"  # name in clearances


class SerializedMessage:
    """Serialized message (CDR, little-endian) that starts with a stamp and ends with doubles.

    To create and serialize a message takes several times as long as to publish its bytes.

    Args:
        message: template for all other fields.
        doubles: number of doubles at the end of the message.
    """

    def __init__(self, message: Any, doubles: int) -> None:
        data = serialize_message(message)
        if data[:2] != b"\0\1":
            raise NotImplementedError(f"CDR of kind {data[:2].hex()}, expected 0001")
        self._data, self._doubles = bytearray(data), len(data) - DOUBLE * doubles

    def set_stamp(self, stamp: int) -> None:
        """Set the stamp [ns]."""
        pack_into("<iI", self._data, STAMP, *divmod(stamp, SECOND))

    def set_doubles(self, first: int, *values: float) -> None:
        """Set doubles, from index `first` on."""
        pack_into(f"<{len(values)}d", self._data, self._doubles + DOUBLE * first, *values)

    def bytes(self) -> bytes:
        """Return the bytes to publish."""
        return bytes(self._data)


class SerializedPose(SerializedMessage):
    """Serialized PoseStamped, as the common VICON receivers publish it."""

    def __init__(self, frame_id: str) -> None:
        super().__init__(pose_stamped(0, frame_id, (0.0, 0.0, 0.0)), 7)

    def serialize(self, stamp: int, reading: SubjectReading) -> bytes:
        """Return the message for a subject; pose and quaternion are zero if it is occluded."""
        x, y, heading = reading.pose
        self.set_stamp(stamp - reading.age)
        if reading.occluded:
            self.set_doubles(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        else:
            self.set_doubles(0, x, y, 0.0, 0.0, 0.0, sin(0.5 * heading), cos(0.5 * heading))
        return self.bytes()


class SerializedGyro(SerializedMessage):
    """Serialized Imu with only the rate about z, which has a standard deviation [rad/s]."""

    def __init__(self, frame_id: str, deviation: float) -> None:
        imu = Imu()
        imu.header.frame_id = frame_id
        imu.orientation_covariance[0] = imu.linear_acceleration_covariance[0] = -1.0  # not measured
        imu.angular_velocity_covariance[8] = deviation**2
        super().__init__(imu, 37)

    def serialize(self, stamp: int, rate: float) -> bytes:
        """Return the message for a rate [rad/s]."""
        self.set_stamp(stamp)
        self.set_doubles(TURN_RATE, rate)
        return self.bytes()


class SerializedClock(SerializedMessage):
    """Serialized Clock."""

    def __init__(self) -> None:
        super().__init__(Clock(), 0)

    def serialize(self, stamp: int) -> bytes:
        """Return the message for a time [ns]."""
        self.set_stamp(stamp)
        return self.bytes()


def truth_message(
    stamp: int,
    frame_id: str,
    bed: Bed,
    plant: Vehicle,
    frame: int = 0,
    markers: Sequence[int] = (0, 0, 0),
) -> SimTruth:
    """Return a vehicle's true state, with the audit of its table and VICON's frame number."""
    audit, error = bed.audit, bed.imbalance.tolist()
    pose, twist = (bed.targets[0].state if bed.targets else np.zeros((2, 3))).tolist()
    nearby = clearances(bed, plant)
    gaps = [pair.gap for pair in nearby]
    message = SimTruth(
        q=plant.q.tolist(),
        qd=plant.qd.tolist(),
        torque=[motion.torque for motion in plant.motions()],
        momentum=audit.momentum.tolist(),
        impulse=audit.impulse.tolist(),
        energy=audit.energy,
        work=audit.work,
        momentum_error=error[:3],
        energy_error=error[3],
        pairs=[f"{pair.one}, {pair.other}" for pair in nearby],
        gaps=gaps,
        clearance=min(gaps, default=inf),
        edge_clearance=plant.edge_clearance,
        valves=plant.valves,
        pressure=plant.thrusters.pressure,
        propellant=plant.thrusters.propellant_used,
        target_present=bool(bed.targets),
        target=pose,
        target_twist=twist,
        holds=plant.holds,
        frame=frame,
        markers=markers,
    )
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message


def clearances(bed: Bed, plant: Vehicle) -> list[Clearance]:
    """Return the gaps of all pairs of parts of which at least one belongs to the vehicle.

    Neighbouring parts of a chain and the table's edge are excluded.
    """
    prefix, gaps = f"{plant.name} " if plant.name else "", bed.clearances()
    return [
        c
        for c in gaps
        if c.other != EDGE_NAME and (c.one.startswith(prefix) or c.other.startswith(prefix))
    ]


def gripper_state(stamp: int, frame_id: str, bed: Bed, plant: Vehicle) -> GripperState:
    """Return the state of the gripper as its sensors measure it."""
    _, approach = bed.within_reach(plant)
    message = GripperState(
        closed=plant.closed,
        holds=plant.holds,
        distance=float(approach.distance),
        angle=approach.angle,
        speed=float(approach.speed),
    )
    message.header.stamp, message.header.frame_id = to_time(stamp), frame_id
    return message
