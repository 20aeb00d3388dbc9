"""The kinds of calibration that there are."""

from typing import Any

from fss_arm_calib.calibration import Calibration
from fss_arm_calib.drift.kind import DRIFT
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.kinematic.kind import KINEMATIC

KINDS: dict[str, Calibration[Any, Any]] = {k.name: k for k in (KINEMATIC, DYNAMIC, DRIFT)}
