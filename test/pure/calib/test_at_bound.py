"""A parameter that ended at its bound is not known: nowhere is it told with a deviation of 0."""

from dataclasses import replace

import numpy as np
import pytest
from calib_joint import ARM, DRIFT, DYNAMIC, SETTINGS, day, drifts, maneuvers

from fss_arm_calib import result
from fss_arm_calib.drift.calibrate import calibrate as calibrate_drift
from fss_arm_calib.drift.kind import DRIFT as DRIFT_KIND
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.dynamic.kind import DYNAMIC as DYNAMIC_KIND
from fss_arm_calib.joint.calibrate import Session, calibrate
from fss_arm_calib.joint.report import joint_report
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES
from fss_arm_calib.messages import common_message
from fss_arm_calib.report_parts import table_report
from fss_arm_ros import report

# Its last link's centre of mass is behind its joint, and the base is pushed as it moves.
IMPOSSIBLE = replace(ARM, links=(*ARM.links[:3], replace(ARM.links[3], b=-0.08)))
PUSHED = np.array([0.0, 0.0, 0.0, 0.0, -0.05])


def outcome(kind):
    rng = np.random.default_rng(1)
    if kind == "drift":
        return calibrate_drift(drifts(ARM, 3, rng, PUSHED), ARM, DRIFT)
    if kind == "dynamic":
        return calibrate_dynamics(maneuvers(IMPOSSIBLE, 8, rng, np.zeros(2)), ARM, DYNAMIC)
    one = Session("monday", day(IMPOSSIBLE, rng).data)
    return calibrate([one], ARM, JointSettings(), JOINT_SOURCES, SETTINGS)


REPORTS = {"drift": DRIFT_KIND.report_of, "dynamic": DYNAMIC_KIND.report_of, "joint": joint_report}
NAMES = {"drift": "drag", "dynamic": "b_4", "joint": "b_4"}
WORDS = {"drift": "resistance to translation, at its bound"}


@pytest.mark.parametrize("kind", NAMES)
def test_a_parameter_at_its_bound_is_said_to_be_there_and_not_determined(kind):
    found, name = outcome(kind), NAMES[kind]
    assert name in found.estimate.at_bound
    if kind != "drift":
        assert found.verdict == "fail"
        assert found.reasons[0].startswith("at a physical bound: b_4")
        assert "condition number" not in found.reason
    told = [REPORTS[kind](found, ARM), table_report(found)]
    for one, words in zip(told, (WORDS.get(kind), None), strict=True):
        table = one.tables[0]
        words = words or f"{name}, at its bound"
        (row,) = (row for row in table.rows if row[0] == words)
        k = table.head.index("± 1 sigma")
        assert row[k] == "-"
        assert float(row[k - 1]) == pytest.approx(found.values[found.names.index(name)], abs=1e-4)
        assert not {"0.0000", "0.000000", "0.00", "+0.0", "+0.00"} & set(row[k:])
        # What is determined has its numbers as ever.
        other = next(r for r in table.rows if r[0] in ("g_x", "tilt along x", "b_1"))
        assert other[k] != "-"
    assert report.printable(told[0])
    # Its deviation and covariance are unknown to programs.
    contents, message = result.contents(kind, found), common_message(kind, found, "")
    at = found.names.index(NAMES[kind])
    assert contents["at_bound"] == list(found.estimate.at_bound)
    assert np.isfinite(contents["values"][at])
    for deviations, covariance in (
        (contents["deviations"], np.array(contents["covariance"])),
        (message.deviations, np.reshape(message.covariance, (len(found.names), -1))),
    ):
        assert deviations[at] == np.inf
        held = [found.names.index(name) for name in found.estimate.at_bound]
        assert np.isnan(covariance[held]).all()
        assert np.isnan(covariance[:, held]).all()
        free = np.delete(np.arange(len(found.names)), held)
        assert np.isfinite(covariance[np.ix_(free, free)]).all()
        assert (np.array(deviations)[free] > 0.0).all()
