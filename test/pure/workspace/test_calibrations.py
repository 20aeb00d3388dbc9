"""Calibrations of the described arm: the newest of each kind counts, those of other arms do not."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import to_yaml
from fss_arm_ros.calibrated import Calibrated
from fss_arm_workspace.calibrations import Calibrations

ARM = paper_arm()
KINEMATIC, DYNAMIC = "calibration/kinematic", "calibration/dynamic"


def passed(arm):
    found = SimpleNamespace(verdict="pass", description=to_yaml(arm), names=[], covariance=[])
    return SimpleNamespace(calibration=found)


def with_mass(mass):
    return replace(ARM, links=(*ARM.links[:3], replace(ARM.links[3], mass=mass)))


def test_the_newest_of_each_kind_counts():
    calibrations = Calibrations(Calibrated(ARM))
    calibrations.add(DYNAMIC, passed(with_mass(3.0)))
    calibrations.add(KINEMATIC, passed(ARM))
    calibrations.add(DYNAMIC, passed(with_mass(2.5)))
    assert list(calibrations.messages) == [KINEMATIC, DYNAMIC]
    assert calibrations.calibrated.arm.links[3].mass == 2.5


def test_a_calibration_of_another_arm_changes_nothing():
    calibrations = Calibrations(Calibrated(ARM))
    calibrations.add(DYNAMIC, passed(with_mass(3.0)))
    with pytest.raises(ValueError, match="it is for 3 links, expected 4"):
        calibrations.add(KINEMATIC, passed(replace(ARM, links=ARM.links[:3])))
    assert list(calibrations.messages) == [DYNAMIC]
    assert calibrations.calibrated.arm == with_mass(3.0)
