"""The state machine of the experiment, step by step in simulated time."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fss_arm_calib.experiment.excitation import plan_excitation
from fss_arm_calib.experiment.sequencer import MAX_REPEATS, Phase, Progress, Seen, Sequencer
from fss_arm_calib.experiment.settings import ExperimentSettings
from fss_arm_calib.experiment.waypoints import TELEMETRY_PERIOD, Waypoint, maneuver_waypoints
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND

START = 1000 * SECOND
REACHED = SimpleNamespace(reached=True, message="")
A, B, C, D = (np.full(4, 0.1 * k) for k in range(4))
POSTURES = [Waypoint(A), Waypoint(B)]
MANEUVERS = [
    Waypoint(A, 0.0, 5.0), Waypoint(B, 2.0, 0.0), Waypoint(C, 3.0, 5.0), Waypoint(D, 1.0, 5.0),
]  # fmt: skip


class Bed:
    """Steps a sequencer every 0.1 s; the arm reaches each waypoint at once unless scripted."""

    def __init__(self, waypoints=POSTURES, progress=None, **settings):
        known = ExperimentSettings(**settings)
        self.sequencer = Sequencer(known, waypoints, progress or Progress())
        self.now, self.goals, self.ready, self.results = START, [], True, []
        self.result = None

    def step(self):
        """Step once; return True if a move was requested."""
        self.now += SECOND // 10
        if self.sequencer.step(self.now, self.ready, self.result):
            self.goals.append(self.sequencer.waypoint.q)
            self.result = self.results.pop(0) if self.results else REACHED
            return True
        return False

    def run(self, until, timeout=100.0):
        """Step until a condition holds; return the time that it took [s]."""
        begun = self.now
        while not until():
            assert self.now < begun + timeout * SECOND, self.lines
            self.step()
        return (self.now - begun) / SECOND

    def arrive(self):
        """Run until the arm is at the next waypoint."""
        count = len(self.goals)
        self.run(lambda: len(self.goals) > count and self.sequencer.phase is Phase.OBSERVE)

    def finish(self, timeout=100.0):
        """Run to the end; return the exit code."""
        self.run(lambda: self.sequencer.exit_code is not None, timeout)
        return self.sequencer.exit_code

    def publish_rests(self, *rests, used=True):
        """Publish rests that end now."""
        new = [Seen(self.now, used, "", np.array(q)) for q in rests]
        self.sequencer.rests = [*self.sequencer.rests, *new]
        self.sequencer.is_observed = True

    def publish_maneuver(self, reason=""):
        """Publish a maneuver that ends now."""
        new = Seen(self.now, not reason, reason)
        self.sequencer.maneuvers = [*self.sequencer.maneuvers, new]
        self.sequencer.is_observed = True

    @property
    def lines(self):
        return [line.words for line in self.sequencer.lines]

    def has_visited(self, *postures):
        return [q.tolist() for q in self.goals] == [q.tolist() for q in postures]


def test_without_a_calibration_node_it_rests_at_each_posture():
    bed = Bed(rest=3.0)
    assert bed.finish() == 0
    assert bed.has_visited(A, B)
    assert 6.0 < (bed.now - START) / SECOND < 7.0
    assert bed.lines == [
        "posture 1 of 2: done, no calibration node observes",
        "posture 2 of 2: done, no calibration node observes",
        "all 2 postures done",
    ]


def test_it_leaves_a_posture_when_that_is_observed():
    bed = Bed(tolerance=0.02)
    bed.arrive()
    bed.publish_rests(B, A + 0.03)
    bed.run(lambda: bed.now > START + 10 * SECOND)
    assert bed.has_visited(A)
    bed.publish_rests(A + 0.01)
    assert bed.run(lambda: len(bed.goals) == 2) < 0.5
    assert "posture 1 of 2: observed" in bed.lines


def test_an_observation_from_before_the_start_does_not_count():
    bed = Bed(observation_timeout=5.0)
    bed.publish_rests(A, B)
    assert bed.finish() == 0
    assert bed.lines.count("posture 1 of 2: not observed") == 1
    bad = [line.bad for line in bed.sequencer.lines if ": not observed" in line.words]
    assert bad == [True] * 2
    assert bed.lines[-1] == "all 2 postures done, 2 not observed"


def test_a_rejected_rest_is_repeated_at_most_three_times():
    bed = Bed([Waypoint(A)], observation_timeout=1.0)
    bed.publish_rests(D, used=False)  # from before the start
    bed.arrive()
    bed.publish_rests(A)
    for _ in range(MAX_REPEATS):
        bed.publish_rests(B, used=False)
        bed.arrive()
    assert bed.finish() == 0
    assert len(bed.goals) > MAX_REPEATS
    assert all((q == B).all() for q in bed.goals[1:])
    assert bed.lines.count("repeating rejected rests: 1") == 1


DISARMED = SimpleNamespace(reached=False, message="link 2 is not armed")


@pytest.mark.parametrize(
    ("result", "words", "wait"),
    [
        (DISARMED, "requesting the move again: link 2 is not armed", 1.0),
        (None, "requesting the move again: no feedback from arm/move", 4.0),
    ],
)
def test_a_move_that_fails_or_is_lost_is_requested_again(result, words, wait):
    bed = Bed()
    bed.results = [result, result]
    assert bed.run(lambda: len(bed.goals) == 3) == pytest.approx(2.0 * wait, abs=0.7)
    assert bed.has_visited(A, A, A)
    assert bed.lines == [words]
    bed.result = None
    for _ in range(100):  # feedback resets the timeout
        bed.step()
        bed.sequencer.receive_feedback(bed.now)
    assert bed.has_visited(A, A, A)


def test_it_waits_for_the_arm_and_after_a_rejected_goal():
    bed = Bed()
    bed.ready = False
    bed.run(lambda: bed.now > START + 5 * SECOND)
    assert (bed.goals, bed.lines) == ([], ["waiting for arm/move"])
    bed.ready = True
    assert bed.step()
    bed.sequencer.reject_move(bed.now)
    assert bed.run(lambda: len(bed.goals) == 2) == pytest.approx(1.0, abs=0.2)


def test_time_that_jumps_back_ends_a_wait():
    bed = Bed(rest=50.0)
    bed.arrive()
    bed.now -= 500 * SECOND
    assert bed.run(lambda: len(bed.goals) == 2) < 0.5


def test_it_resumes_and_tells_how_far_it_is():
    """Also where more postures are done than there are."""
    bed = Bed(progress=Progress(START - SECOND, 1), rest=1.0, state_file="p.json")
    expected = "after 1 of 2 postures; the next run resumes from p.json"
    assert bed.sequencer.unfinished == expected
    assert bed.finish() == 0
    assert bed.has_visited(B)
    assert bed.sequencer.progress == Progress(START - SECOND, 2)
    assert bed.sequencer.unfinished == ""
    bed = Bed(progress=Progress(START, 9))
    assert bed.finish() == 0
    assert bed.goals == []


def test_a_rejected_maneuver_is_repeated_after_the_way_back():
    bed = Bed(MANEUVERS, maneuvers="plan", observation_timeout=20.0)
    for _ in range(3):
        bed.arrive()
    bed.publish_maneuver("a gap")
    bed.run(lambda: len(bed.goals) == 7)
    assert bed.has_visited(A, B, C, B, A, B, C)
    back = ["posture 3 of 4: a gap; returning to repeat it", "back at posture 1"]
    assert bed.lines[bed.lines.index(back[0]) :][:2] == back
    bed.run(lambda: bed.sequencer.phase is Phase.OBSERVE)
    bed.publish_maneuver()
    bed.run(lambda: len(bed.goals) == 8)
    for _ in range(MAX_REPEATS + 1):
        bed.run(lambda: bed.sequencer.phase is Phase.OBSERVE and (bed.goals[-1] == D).all())
        bed.publish_maneuver("a gap")
        bed.run(lambda: bed.sequencer.phase is not Phase.OBSERVE)
    assert bed.finish() == 0
    assert bed.has_visited(A, B, C, B, A, B, C, D, C, D, C, D, C, D)
    assert bed.lines[-2:] == [
        "posture 4 of 4: continuing without an observation",
        "all 4 postures done, 1 not observed",
    ]


def test_a_maneuver_that_no_node_finds_is_given_up():
    bed = Bed(MANEUVERS[:3], maneuvers="plan", observation_timeout=4.0)
    bed.sequencer.is_observed = True
    assert bed.finish() == 0
    assert bed.lines.count("posture 3 of 3: not observed") == 1
    assert 5.0 + 5.0 + 4.0 < (bed.now - START) / SECOND < 16.0


def test_it_ends_when_the_goal_is_met_but_not_within_a_maneuver():
    bed = Bed(MANEUVERS, maneuvers="plan", goal="b_i 0.002")
    bed.sequencer.promised = {"b_1": 0.0015}
    bed.arrive()
    bed.arrive()
    bed.sequencer.compare_with_goal(bed.now, "pass", "good", {"b_1": 0.001, "b_2": 0.0011})
    assert bed.finish() == 0
    assert bed.has_visited(A, B, C)
    assert bed.lines[-1] == (
        "goal met after 3 of 4 postures: pass, b_1 ± 0.001 (goal 0.002, promised 0.0015), "
        "b_2 ± 0.0011 (goal 0.002)"
    )


def test_at_the_end_it_waits_for_the_result_of_the_last_data():
    beds = [Bed([Waypoint(A)], goal="a_1 0.001", observation_timeout=10.0) for _ in range(2)]
    for bed in beds:
        bed.arrive()
        bed.publish_rests(A)
    bed, late = beds
    bed.sequencer.compare_with_goal(bed.now, "fail", "an outlier", {"a_1": 0.0001})
    assert bed.finish() == "goal not met: fail (an outlier), a_1 ± 0.0001 (goal 0.001)"
    assert "waiting for the calibration" not in bed.lines
    assert late.finish() == "goal not met: no calibration result received"
    assert late.lines[-2:] == ["waiting for the calibration", "all 1 postures done"]
    assert (late.now - START) / SECOND > 10.0


def test_a_move_starts_after_its_delay():
    bed = Bed([Waypoint(A, 0.0, 1.0), Waypoint(B, 1.0, 0.0), Waypoint(C, 1.0, 1.0, delay=0.7)])
    requested = []
    while bed.sequencer.exit_code is None:
        if bed.step():
            requested.append((bed.now - START) / SECOND)
    _, second, third = requested
    assert third - second == pytest.approx(0.7, abs=0.21)  # and two steps
    assert third - second > 0.7


def test_moves_of_single_joints_start_at_all_phases_of_slow_telemetry():
    plan = plan_excitation(paper_arm())
    delays = [stop.delay for stop in maneuver_waypoints(plan, 5.0)]
    phases = np.sort(delays) / TELEMETRY_PERIOD
    assert phases[0] < 0.02
    assert phases[-1] < 1.0
    assert np.diff([*phases, 1.0]).max() < 0.03  # of 97; evenly spread they are 0.01 apart
    others = maneuver_waypoints([replace(one, kind="reorientation") for one in plan], 5.0)
    assert not any(stop.delay for stop in others)
