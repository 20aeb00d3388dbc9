"""Poses of the base on its way count where they are asked for; joints that give show in them."""

from dataclasses import replace
from itertools import compress
from pathlib import Path

import numpy as np
import pytest
from calib_float import Float, postures
from calib_joint import errors
from calib_rig import feed
from sim_rehearsal import DYNAMIC, Rehearsal

from fss_arm_calib.acceptance import FAIL, PASS
from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_model.base_motion import base_poses
from fss_arm_model.parameters import parameter_names

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


def rehearsed(preset, count=13):
    """Maneuvers between some postures seen on the way, the true arm, and the streams."""
    postures = DEFAULT_POSTURES[:count]
    run = Rehearsal(CONFIG, seed=1, preset=preset, dynamic=ALONG, postures=postures)
    run.run()
    return run.maneuvers, run.truth, run.maneuver_finder.streams()


def at_rest(maneuver):
    """Return the maneuver without the poses that `path_rate` adds."""
    kept = ~maneuver.in_motion
    fields = ("marks", "poses", "frames", "seconds")
    return replace(maneuver, **{k: tuple(compress(getattr(maneuver, k), kept)) for k in fields})


@pytest.mark.parametrize("count", [7, pytest.param(13, marks=pytest.mark.slow)])
def test_they_tell_more_of_inertias(count):
    maneuvers, truth, streams = rehearsed("default", count)
    along = calibrate(maneuvers, truth, ALONG, streams)
    assert along.verdict == PASS
    alone = calibrate([at_rest(one) for one in maneuvers], truth, DYNAMIC, streams)
    names = [name for name in along.names if name in parameter_names(4)]
    away = errors(names, along.values[: len(names)], truth) / along.deviations[: len(names)]
    assert np.abs(away).max() < 3.5
    inertias = [along.names.index(f"I_{i}") for i in range(1, 5)]
    assert (along.deviations[inertias] < 0.7 * alone.deviations[inertias]).all()


@pytest.mark.slow
def test_of_joints_that_give_the_verdict_says_that_it_does_not_fit():
    maneuvers, truth, streams = rehearsed("laboratory")
    outcome = calibrate(maneuvers, truth, ALONG, streams)
    assert outcome.verdict == FAIL
    assert "residuals are larger than the deviations allow" in outcome.reason
