"""Settings that the loops share: their defaults, and parameters that have no effect in them."""

from math import cos, pi, sin

from fss_gnc.control.settings import ControlSettings
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.navigation.settings import NavigationSettings
from fss_rehearsal.loops.parameters import WITHOUT_NODES, ArmValues, Without
from fss_sim.settings import TestbedSettings

POSTURE = 0.95, 1.3, 1.36, -1.23  # [rad]
TESTBED = TestbedSettings(
    base=(1.6 * cos(-0.75 * pi), 1.6 * sin(-0.75 * pi), -1.4),
    q=POSTURE,
    target_mass=10.0,
    target_pose=(0.0, 0.0, -0.3),
    target_twist=(-0.006, 0.004, 0.15),
)
#: Parameters of the test bed without effect in a loop without electronics, links and markers.
WITHOUT_ELECTRONICS = Without(
    *WITHOUT_NODES,
    "telemetry_rate",
    "vicon_jitter",
    "vicon_edge_error",
    "vicon_occlusion",
    "vicon_merge*",
    "vicon_cameras",
    "*_markers",
    "marker_*",
    "heights",
    "wifi*",
    "torque_noise",
    "torque_zero",
    "torque_crosstalk",
    "torque_drift",
    "torque_rate",
    "clock_drift",
    "encoder_eccentricity",
    "battery*",
    "faults",
    "twist",
)

#: Parameters of the navigation without effect in a loop without topics.
WITHOUT_TOPICS = Without("latency", "rate", "*_topic", "*_frame", "frame_prefix")

GUIDANCE, NAVIGATION, CONTROL = MissionSettings(), NavigationSettings(), ControlSettings()
NO_VALUES = ArmValues()
