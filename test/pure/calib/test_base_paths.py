"""Poses of the base on its way count where they are asked for; joints that give show in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calib_float import Float, feed, postures
from sim_rehearsal import DYNAMIC, Rehearsal

from fss_arm_calib.acceptance import FAIL, PASS
from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_model.base_motion import base_poses
from fss_arm_model.parameters import parameter_names, values

CONFIG = Path(__file__).parents[3] / "config"
ALONG = replace(DYNAMIC, path_rate=2.0)


def test_poses_on_the_way_are_where_the_base_was():
    rig = Float(postures(1, seed=3))
    samples = rig.samples()
    (alone,), (one,) = (feed(ManeuverFinder(4, s), samples) for s in (DYNAMIC, ALONG))
    assert (
        0 <= one.in_motion.sum() - 2.0 * (rig.ends[0] - rig.begins[0]) < 4
    )  # until it has settled
    assert not alone.in_motion.any()
    assert set(alone.marks) < set(one.marks)
    assert list(one.marks) == sorted(one.marks)
    state = np.zeros(8)
    state[:3] = one.poses[0]
    assert np.array(one.poses) == pytest.approx(base_poses(rig.vector, one.path, state), abs=2e-3)


def found(preset, settings):
    run = Rehearsal(CONFIG, seed=1, preset=preset, dynamic=settings)
    run.run()
    outcome = calibrate(run.maneuvers, run.truth, settings, run.maneuver_finder.streams())
    true = dict(zip(parameter_names(4), values(run.truth), strict=True))
    rows = zip(outcome.names, outcome.values, outcome.deviations, strict=True)
    errors = [(x - true[name]) / sigma for name, x, sigma in rows if name in true]
    inertias = [sigma for name, sigma in zip(outcome.names, outcome.deviations, strict=True)
                if name[0] == "I"]  # fmt: skip
    return outcome, np.abs(errors).max(), np.array(inertias)


def test_they_tell_more_of_inertias():
    outcome, largest, along = found("default", ALONG)
    assert outcome.verdict == PASS
    assert largest < 3.5
    assert (along[:4] < 0.7 * found("default", DYNAMIC)[2][:4]).all()


@pytest.mark.slow
def test_of_joints_that_give_the_verdict_says_that_it_does_not_fit():
    outcome, _, _ = found("laboratory", ALONG)
    assert outcome.verdict == FAIL
    assert "residuals are larger than the deviations allow" in outcome.reason
