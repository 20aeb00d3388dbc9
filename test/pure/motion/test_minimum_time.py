"""The fastest motion between two postures, against a direct transcription that shares nothing."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_motion.limits import Limits, LimitSettings
from fss_arm_motion.plan import Start
from fss_arm_motion.point_to_point import PointToPoint, point_to_point

# Bodies may pass through each other, and rotors are left out: the oracle knows neither.
SETTINGS = LimitSettings(share=1.0, rotor_inertia=0.0, base_radius=0.0, link_radius=0.0, margin=0.0)
#: Seconds that `bench/direct_transcription.py` finds with 40 nodes, by seed.
LEAST_TIMES = {
    0: 2.3520,
    1: 2.2769,
    2: 2.1275,
    3: 1.5976,
    4: 1.3724,
    5: 2.4526,
    6: 1.6682,
    7: 2.5030,
}


@pytest.mark.parametrize(("seed", "least_time"), LEAST_TIMES.items())
def test_it_is_within_two_percent_of_the_transcriptions(seed, least_time):
    arm = paper_arm()
    begin, end = np.random.default_rng(seed).uniform(-1.3, 1.3, (2, 4))
    start = Start(arm, begin, limits=Limits.of(arm, SETTINGS))
    plan = point_to_point(start, PointToPoint(tuple(end)))
    assert least_time > 0.99 * plan.notes["least_possible"]
    assert plan.duration == pytest.approx(least_time, rel=0.02)


@pytest.mark.parametrize("way", [0.02, 0.1, 0.3])
def test_a_short_way_takes_what_its_acceleration_takes(way):
    start = Start(paper_arm(), np.zeros(4), limits=Limits.of(paper_arm(), SETTINGS))
    plan = point_to_point(start, PointToPoint((0.0, 0.0, 0.0, way)))
    assert plan.duration < max(0.27, 1.1 * 2.0 * np.sqrt(way / 2.0))
