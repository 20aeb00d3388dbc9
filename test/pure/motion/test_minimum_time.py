"""The fastest motion between two postures, against a direct transcription that shares nothing."""

import numpy as np
import pytest
from motion_oracles import direct_transcription

from fss_arm_model.description import paper_arm
from fss_arm_motion.limits import Limits, LimitSettings
from fss_arm_motion.plan import Start
from fss_arm_motion.point_to_point import PointToPoint, point_to_point

# Bodies may pass through each other, and rotors are left out: the oracle knows neither.
SETTINGS = LimitSettings(
    share=1.0, rotor_inertia=0.0, base_radius=0.0, link_radius=0.0, margin=0.0
)  # fmt: skip


@pytest.mark.parametrize(
    "seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 8))]
)
def test_it_is_within_two_percent_of_the_transcriptions(seed):
    arm, rng = paper_arm(), np.random.default_rng(seed)
    begin, end = rng.uniform(-1.3, 1.3, (2, 4))
    limits = Limits.of(arm, SETTINGS)
    plan = point_to_point(Start(arm, begin, limits=limits), PointToPoint(tuple(end)))
    reference = direct_transcription(arm, limits, begin, end, nodes=40)
    assert reference > 0.99 * plan.notes["least_possible"]
    assert plan.duration < 1.02 * reference
    assert plan.duration > 0.98 * reference  # or the oracle is no oracle


@pytest.mark.parametrize("way", [0.02, 0.1, 0.3])
def test_a_short_way_takes_what_its_acceleration_takes(way):
    start = Start(paper_arm(), np.zeros(4), limits=Limits.of(paper_arm(), SETTINGS))
    plan = point_to_point(start, PointToPoint((0.0, 0.0, 0.0, way)))
    assert plan.duration < max(0.27, 1.1 * 2.0 * np.sqrt(way / 2.0))
