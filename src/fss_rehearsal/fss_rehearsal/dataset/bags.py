"""Bags of the data set: an experiment without ROS, recorded as drivers and recorder would."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from fss_arm_bags.definitions import definition
from fss_arm_bags.storage import CheckedWriter
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.design import design
from fss_arm_calib.experiment.excitation import plan_excitation
from fss_arm_calib.experiment.postures import default_postures
from fss_arm_calib.experiment.settings import Conditions
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_driver.messages import SampleMessages
from fss_arm_driver.session import LinkSession, Sample
from fss_arm_model.description import Arm
from fss_arm_model.units import GRAVITY, SECOND
from fss_rehearsal.dataset.arms import ArmPair
from fss_rehearsal.loops.calibration import Experiment
from fss_sim.messages import SerializedGyro, SerializedPose
from fss_sim.noise import PRESETS
from fss_sim.sensors import Readings
from fss_sim.settings import TestbedSettings

KINDS = "kinematic", "dynamic", "drift", "drives"
USED_PRESETS = "ideal", "default", "laboratory"
MANEUVERS_PER_LINK, MORE_MANEUVERS = 4, 4  # of a dynamic experiment
CANDIDATES = 100  # tried for each maneuver
EXCITATION_REPEATS = 2  # of the moves of single joints
REST = 5.2  # between maneuvers [s]
DRIFT_TIME = 120.0  # [s]
#: Hose and table of a drift; its result has these names: tilt as gravity along the table [m/s^2].
DRIFT_TRUTH = {
    "g_x": GRAVITY * 2e-5,
    "g_y": GRAVITY * -1e-5,
    "torque": 0.0,
    "twist_damping": 0.01,
    "drag": 0.02,
}
#: Of the base at the start: the longest arm stays clear of the table's edge.
LARGEST_TWIST = 0.0005, 0.0005, 0.002  # [m/s, m/s, rad/s]
#: The base drifts uphill and returns: tilt alone would move it 1.4 m in this time.
DRIFT_POSE, DRIFT_TWIST = (-0.2, -0.1, -0.2), (-0.012, 0.006, 0.003)  # [m, m, rad], [m/s, rad/s]
DRIFT_ANGLE = 0.8  # of the joints in a drift, with alternating sign [rad]

Clock = Callable[[], int]


class BagRecorder:
    """Writer of a bag with the topics of joints, links, motion capture and gyro.

    Args:
        path: of the bag, which must not exist.
        links: sessions of the links' drivers.
        clock: returns the time of the drivers' computer [ns].
        gyro_deviation: of a turn rate [rad/s].
    """

    def __init__(
        self, path: Path, links: Sequence[LinkSession], clock: Clock, gyro_deviation: float
    ) -> None:
        self.clock, self.writer = clock, CheckedWriter(path)
        self.writer.open()
        self.pose, self.gyro = SerializedPose("world"), SerializedGyro("fss", gyro_deviation)
        self.links = [SampleMessages(link) for link in links]
        self.joint_states = self._topic("joint_states", "sensor_msgs/msg/JointState")
        self.telemetry = [
            self._topic(f"link_{i}/telemetry", "fss_arm_msgs/msg/LinkTelemetry")
            for i in range(1, len(links) + 1)
        ]
        pose = "geometry_msgs/msg/PoseStamped"
        self.base = self._topic(TestbedSettings.base_topic, pose)
        self.tip = self._topic(TestbedSettings.tip_topic, pose)
        self.rates = self._topic("fog/imu", "sensor_msgs/msg/Imu")

    def _topic(self, name: str, msgtype: str) -> Callable[[bytes], None]:
        """Add a topic; return the function that writes a serialized message."""
        text, digest = definition(msgtype)
        connection = self.writer.add_connection(
            f"/{name.lstrip('/')}", msgtype, msgdef=text, rihs01=digest
        )
        return lambda data: self.writer.write(connection, self.clock(), data)

    def __call__(self, samples: Mapping[int, Sample], readings: Readings) -> None:
        """Write what drivers and motion capture publish in a frame."""
        now = self.clock()
        for i, sample in samples.items():
            self.joint_states(serialize_message(self.links[i].joint_state(sample)))
            self.telemetry[i](serialize_message(self.links[i].telemetry(sample, now)))
        for write, seen in ((self.base, readings.base), (self.tip, readings.tip)):
            if seen:
                write(self.pose.serialize(now, seen))
        if readings.rate is not None:
            self.rates(self.gyro.serialize(now, readings.rate))

    def close(self) -> None:
        """Complete the bag."""
        self.writer.close()


def testbed_of(kind: str, preset: str, n: int, q: Sequence[float], seed: int) -> TestbedSettings:
    """Return the test bed of an experiment, which starts with joints at q [rad]."""
    rng = np.random.default_rng(seed)
    heading = float(rng.uniform(-3.0, 3.0))
    twist = (rng.uniform(-1.0, 1.0, 3) * LARGEST_TWIST).tolist()
    found = TestbedSettings(preset=preset, q=tuple(q), base=(0.0, 0.0, heading), twist=tuple(twist))
    if kind == "drives":
        return replace(found, twist=(0.0, 0.0, 0.0))
    if kind == "drift":
        tilt = DRIFT_TRUTH["g_x"] / GRAVITY, DRIFT_TRUTH["g_y"] / GRAVITY
        return replace(
            found,
            base=DRIFT_POSE,
            twist=DRIFT_TWIST,
            tilt=tilt,
            tether_drag=DRIFT_TRUTH["drag"],
            tether_twist=DRIFT_TRUTH["twist_damping"],
        )
    return found


def plan(kind: str, arm: Arm, seed: int) -> Any:
    """Return the postures or maneuvers of an experiment, planned with the description.

    Raises:
        NoManeuver: no maneuver satisfies the conditions.
    """
    match kind:
        case "kinematic":
            return default_postures(arm)
        case "dynamic":
            count = MANEUVERS_PER_LINK * arm.n + MORE_MANEUVERS
            conditions = Conditions(rest=REST)
            return design(arm, count, DynamicSettings(), conditions, seed=seed, tried=CANDIDATES)
        case "drives":
            return plan_excitation(arm, EXCITATION_REPEATS, seed=seed)
    return ()


def record(path: Path, kind: str, preset: str, pair: ArmPair, planned: Any, seed: int) -> None:
    """Run the experiment of a kind of calibration, as planned, and write its bag.

    The bag ends early if the arm does not reach a waypoint, as with a joint that sticks.
    """
    n = pair.truth.n
    first = planned[0] if kind == "kinematic" else planned[0].waypoints[0] if planned else ()
    q = (
        [float(angle) for angle in first]
        if len(first)
        else [DRIFT_ANGLE * (-1) ** i for i in range(n)]
    )
    testbed = testbed_of(kind, preset, n, q, seed)
    experiment = Experiment(
        pair.truth,
        pair.described,
        testbed.noise(),
        testbed.world(),
        replace(testbed.state_from_parameters(n), boot_offset=0),
        seed,
        KinematicSettings(),
        DynamicSettings(),
        rate=testbed.telemetry_rate,
        vicon=testbed.vicon(seed, (0, 1)),
    )
    clock = partial(getattr, experiment, "now")
    recorder = BagRecorder(path, experiment.links, clock, PRESETS[preset].gyro_noise)
    experiment.recorder = recorder
    try:
        if kind == "kinematic":
            experiment.run(planned)
        elif planned:
            with suppress(TimeoutError):
                experiment.make_maneuvers(planned, REST)
        while kind == "drift" and experiment.bed.now < DRIFT_TIME * SECOND:
            experiment.step()
    finally:
        recorder.close()
