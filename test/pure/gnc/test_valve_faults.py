"""Valves that stay open or closed are found by what momentum does, and none that does not."""

import numpy as np
import pytest
from capturing import POSTURE, Case, Flight

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.thrusters import COUNT, layout
from fss_gnc.navigation import EstimatorSettings, KnownInputs
from fss_gnc.navigation.caught import Sample
from fss_gnc.navigation.valve_faults import SPACING, Faults, Moment, ValveFaults, moved

P = paper_arm().vector()
VALVES = layout(0.16, 0.11)
NOISE = np.array([8e-4, 8e-4, 3e-4])  # of a twist [m/s, m/s, rad/s]
NEVER, NONE = 60.0, Faults()  # [s]


class Bed:
    """A base that floats from rest, its arm held, and the watch over its valves."""

    def __init__(self, seed=1, thrust=1.0):
        self.rng, self.thrust = np.random.default_rng(seed), thrust
        self.watch = ValveFaults(0.05)
        self.t, self.q, self.momentum = 0.0, np.array([0.3, -0.2, 0.4, *POSTURE]), np.zeros(3)
        self.told, self.wide = np.zeros((2, COUNT, 3))

    def step(self, shares, faults=NONE, push=(0.0, 0.0, 0.0)):
        """Valves are told to be open for these shares of a step; what is found then."""
        x, y, heading = self.q[:3]
        turned = np.exp(1j * heading) * (VALVES[:, 0] + 1j * VALVES[:, 1])
        each = np.stack([turned.real, turned.imag, VALVES[:, 2]], 1) * SPACING
        each[:, 2] += x * each[:, 1] - y * each[:, 0]  # about the world's origin
        self.told, self.wide = self.told + shares[:, None] * each, self.wide + each
        really = np.array(shares)
        really[list(faults.open)], really[list(faults.closed)] = 1.0, 0.0
        self.momentum += self.thrust * really @ each + SPACING * np.array(push)
        H = inertia_matrix(P, self.q)[:3]
        twist = np.linalg.solve(H[:, :3], moved(np.zeros(2), self.q[:2]) @ self.momentum)
        self.q[:3] += SPACING * twist
        self.t += SPACING
        qd = np.concatenate([twist + NOISE * self.rng.standard_normal(3), np.zeros(4)])
        sample = Sample(self.t, self.q.copy(), qd, np.diag(NOISE**2), np.full(4, 5e-4), np.zeros(3))
        if self.watch.is_due(self.t):
            self.watch.look(P, Moment(sample, self.told, self.wide), 0.0)
        return self.watch.found

    def until_found(self, shares, valve=False, **how):
        """What is found first, or of a valve, and when; shares() are told anew in each step."""
        before = self.watch.found[:2]
        while self.t < NEVER:
            found = self.step(shares(), **how)
            if found[:2] != before or (found.pushed and not valve):
                return found, self.t
        return NONE, NEVER


def some(rng):
    """Shares of a control that is busy."""
    return rng.uniform(0.0, 1.0, COUNT) * (rng.uniform(size=COUNT) < 0.3)


@pytest.mark.parametrize("valve", range(COUNT))
def test_a_valve_that_does_not_close_is_found_in_seconds(valve):
    bed = Bed(valve)
    found, at = bed.until_found(lambda: np.zeros(COUNT), faults=Faults(open=frozenset({valve})))
    assert found == Faults(open=frozenset({valve}))
    assert at < 4.0


@pytest.mark.parametrize("valve", range(COUNT))
def test_it_is_found_among_those_that_are_busy(valve):
    bed, faults = Bed(10 + valve), Faults(open=frozenset({valve}))
    found, at = bed.until_found(lambda: some(bed.rng), True, faults=faults)
    assert found == faults
    assert at < 6.0


def test_a_valve_that_does_not_open_is_noticed_and_no_other_one_is_blamed():
    named = 0
    for valve in range(COUNT):
        bed, faults = Bed(20 + valve), Faults(closed=frozenset({valve}))
        much = np.arange(COUNT) == valve

        def shares(bed=bed, much=much):
            return much * bed.rng.uniform(0.3, 1.0)

        told = {"shares": shares, "faults": faults}
        found, at = bed.until_found(**told)
        assert found in (faults, Faults(pushed=True))
        assert at < 6.0
        named += bed.until_found(valve=True, **told)[0].closed == {valve}
        assert not bed.watch.found.open
    assert named >= COUNT // 2


@pytest.mark.parametrize("thrust", [0.95, 1.0, 1.05])
def test_noise_thrust_and_a_table_that_slopes_are_no_faults(thrust):
    bed = Bed(3, thrust)
    slope = 0.015, 0.0, 0.0  # 0.1 mrad for 15 kg [N]
    found, at = bed.until_found(lambda: 0.5 * some(bed.rng), push=slope)
    assert (found, at) == (NONE, NEVER)


def test_what_no_valve_gives_is_said_to_push_and_forgotten_when_it_ends():
    bed = Bed(4)
    found, at = bed.until_found(lambda: np.zeros(COUNT), push=(0.0, 0.3, 0.3))
    assert found == Faults(pushed=True)
    assert at < 3.0
    for _ in range(20):
        found = bed.step(np.zeros(COUNT))
    assert found == NONE


def test_a_valve_open_and_one_told_against_it_that_stays_closed_look_alike():
    against = np.zeros(COUNT)
    against[2] = 1.0  # pushes as valve 0 does, the other way
    for faults in (Faults(open=frozenset({0})), Faults(closed=frozenset({2}))):
        assert Bed(5).until_found(lambda: against, faults=faults)[0] == Faults(pushed=True)


def test_what_seemed_to_be_closed_is_not_once_another_is_found_to_be_open():
    bed = Bed(6)
    bed.watch.found = Faults(closed=frozenset({2}))
    opened = Faults(open=frozenset({0}))
    assert bed.until_found(lambda: np.zeros(COUNT), True, faults=opened)[0] == opened


def test_the_base_is_predicted_with_what_valves_really_do():
    now, ms = 100 * 10**9, 10**6

    def over(on_times, faults=NONE):
        inputs = KnownInputs(P, EstimatorSettings(valve_delay=0.0))
        for i, q in enumerate(POSTURE):
            inputs.joint(i, now, q, 0.0, 0.0)
        inputs.fail(faults)
        inputs.pulses(now, on_times)
        return inputs.over([now, now + 50 * ms, now + 100 * ms])[0]

    one, other = 0.1 * np.eye(COUNT)[[2, 5]]
    faults = Faults(open=frozenset({2}), closed=frozenset({5}))
    np.testing.assert_allclose(over(other, faults), over(one), rtol=1e-12, atol=1e-15)
    assert np.abs(over(other) - over(one)).max() > 1e-3


@pytest.mark.parametrize(
    "phase", ["reach", *(pytest.param(p, marks=pytest.mark.slow) for p in ("approach", "detumble"))]
)
def test_a_mission_whose_valve_does_not_close_is_aborted_in_time(phase):
    flight = Flight(Case(spin=0.2, heading=3.0, seed=3, fault="open", phase=phase))
    flown = flight.fly()
    assert flown.safe
    assert flown.phases[-1] == "abort"
    assert flight.faults[0][0] < flight.faulted + 8.0
    assert not any(faults.closed for _, faults in flight.faults)
