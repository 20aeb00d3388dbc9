"""Registry of the kinds of calibration by name; the joint estimate is separate."""

from typing import Any

from fss_arm_calib.calibration import Calibration
from fss_arm_calib.drift.kind import DRIFT
from fss_arm_calib.drives.kind import DRIVES
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.kinematic.kind import KINEMATIC

KINDS: dict[str, Calibration[Any, Any]] = {
    kind.name: kind for kind in (KINEMATIC, DYNAMIC, DRIFT, DRIVES)
}
#: Kinds whose data a joint estimate combines.
JOINT_SOURCES = {name: kind for name, kind in KINDS.items() if kind.measurements}
