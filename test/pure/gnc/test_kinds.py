"""Actions of the guidance: their goals, feedback and results."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_gnc.guidance.activity import Craft, Observation, Outcome
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.kinds import KINDS
from fss_gnc.reference import Body

CRAFT = Craft(paper_arm())
AT_REST = Observation(
    0.0,
    Body(np.zeros(3), np.zeros(3)),
    None,
    np.array([1.5, -1.5, -1.5, 1.5]),
    np.zeros(4),
    holds=True,
)
GOALS = {
    "base/go_to": {"pose": [0.1, 0.0, 0.0]},
    "base/follow": {"time": [0.0, 9.0], "pose": 6 * [0.0]},
}
DONE = {
    "base/hold": "held",
    "base/go_to": "reached",
    "base/follow": "reached",
    "mission/capture": "stopped",
    "mission/detumble": "stopped",
    "mission/abort": "safe",
}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_feedback_and_results_fit_their_actions(kind):
    goal = kind.action.Goal(**GOALS.get(kind.name, {}))
    if kind.name == "mission/capture":
        goal.detumble = True
    activity = kind.start(CRAFT, AT_REST, goal)
    kind.action.Feedback(**kind.feedback(activity, activity.step(AT_REST)))
    for success in (False, True):
        fields = kind.result(activity, Budget(CRAFT), Outcome(success))
        result = kind.action.Result(message="", **fields)
        assert getattr(result, DONE[kind.name]) == (success or kind.name == "mission/abort")


@pytest.mark.parametrize(
    ("reason", "shown"),
    [("", "requested by the operator"), ("lost\nit", "lost it"), (9000 * "x", 200 * "x")],
)
def test_abort_shortens_any_reason_to_one_line(reason, shown):
    kind = KINDS[-1]
    assert kind.start(CRAFT, AT_REST, kind.action.Goal(reason=reason)).reason == shown
