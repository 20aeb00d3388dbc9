"""Detection of valves that stay open or closed, without false alarms."""

import numpy as np
import pytest
from capturing import POSTURE, Case, Flight

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.thrusters import THRUSTER_COUNT, thruster_wrenches
from fss_gnc.navigation import EstimatorSettings, KnownInputs
from fss_gnc.navigation.mass_estimator import Sample
from fss_gnc.navigation.valve_faults import SPACING, Faults, Moment, ValveFaults, shift_momentum

P = paper_arm().vector()
VALVES = thruster_wrenches(0.16, 0.11)
NOISE = np.array([8e-4, 8e-4, 3e-4])  # of a twist [m/s, m/s, rad/s]
TIMEOUT = 60.0  # [s]
NO_FAULTS = Faults()


class Bed:
    """A floating base with its arm held, and the monitor of its valves."""

    def __init__(self, seed=1, thrust=1.0):
        self.rng, self.thrust = np.random.default_rng(seed), thrust
        self.monitor = ValveFaults(0.05)
        self.t, self.q, self.momentum = 0.0, np.array([0.3, -0.2, 0.4, *POSTURE]), np.zeros(3)
        self.commanded, self.always_open = np.zeros((2, THRUSTER_COUNT, 3))

    def step(self, shares, faults=NO_FAULTS, push=(0.0, 0.0, 0.0)):
        """Open the valves for these fractions of a step; return the detected faults."""
        x, y, heading = self.q[:3]
        turned = np.exp(1j * heading) * (VALVES[:, 0] + 1j * VALVES[:, 1])
        each = np.stack([turned.real, turned.imag, VALVES[:, 2]], 1) * SPACING
        each[:, 2] += x * each[:, 1] - y * each[:, 0]  # about the world's origin
        self.commanded = self.commanded + shares[:, None] * each
        self.always_open = self.always_open + each
        actual = np.array(shares)
        actual[list(faults.open)], actual[list(faults.closed)] = 1.0, 0.0
        self.momentum += self.thrust * actual @ each + SPACING * np.array(push)
        H = inertia_matrix(P, self.q)[:3]
        twist = np.linalg.solve(H[:, :3], shift_momentum(np.zeros(2), self.q[:2]) @ self.momentum)
        self.q[:3] += SPACING * twist
        self.t += SPACING
        qd = np.concatenate([twist + NOISE * self.rng.standard_normal(3), np.zeros(4)])
        sample = Sample(self.t, self.q.copy(), qd, np.diag(NOISE**2), np.full(4, 5e-4), np.zeros(3))
        if self.monitor.is_due(self.t):
            self.monitor.update(P, Moment(sample, self.commanded, self.always_open), 0.0)
        return self.monitor.faults

    def until_found(self, shares, valve=False, **how):
        """Step until a fault is detected, of a `valve` only if so; return faults and time."""
        before = self.monitor.faults[:2]
        while self.t < TIMEOUT:
            found = self.step(shares(), **how)
            if found[:2] != before or (found.unknown_push and not valve):
                return found, self.t
        return NO_FAULTS, TIMEOUT


def random_shares(rng):
    """Return fractions of a step, as of a busy controller."""
    return rng.uniform(0.0, 1.0, THRUSTER_COUNT) * (rng.uniform(size=THRUSTER_COUNT) < 0.3)


@pytest.mark.parametrize(("used", "most"), [(0.0, 4.0), (1.0, 6.0)])
@pytest.mark.parametrize("valve", [0, 2, 7])
def test_open_valve_is_detected_whether_or_not_others_are_used(valve, used, most):
    bed, faults = Bed(10 + valve), Faults(open=frozenset({valve}))
    found, at = bed.until_found(lambda: used * random_shares(bed.rng), used > 0.0, faults=faults)
    assert found == faults
    assert at < most


def test_closed_valve_is_detected_and_no_other_valve_is_suspected():
    isolated = 0
    for valve in range(THRUSTER_COUNT):
        bed, faults = Bed(20 + valve), Faults(closed=frozenset({valve}))
        is_faulty = np.eye(THRUSTER_COUNT)[valve]

        def shares(bed=bed, is_faulty=is_faulty):
            return is_faulty * bed.rng.uniform(0.3, 1.0)

        found, at = bed.until_found(shares, faults=faults)
        assert found in (faults, Faults(unknown_push=True))
        assert at < 6.0
        isolated += bed.until_found(shares, True, faults=faults)[0].closed == {valve}
        assert not bed.monitor.faults.open
    assert isolated >= THRUSTER_COUNT // 2


@pytest.mark.parametrize("thrust", [0.95, 1.0, 1.05])
def test_noise_thrust_error_and_tilt_cause_no_false_alarm(thrust):
    bed = Bed(3, thrust)
    slope = 0.015, 0.0, 0.0  # 0.1 mrad for 15 kg [N]
    found, at = bed.until_found(lambda: 0.5 * random_shares(bed.rng), push=slope)
    assert (found, at) == (NO_FAULTS, TIMEOUT)


def test_external_push_is_reported_until_it_ends():
    bed = Bed(4)
    found, at = bed.until_found(lambda: np.zeros(THRUSTER_COUNT), push=(0.0, 0.3, 0.3))
    assert found == Faults(unknown_push=True)
    assert at < 3.0
    for _ in range(20):
        found = bed.step(np.zeros(THRUSTER_COUNT))
    assert found == NO_FAULTS


def test_open_valve_and_opposite_closed_valve_are_indistinguishable():
    against = np.zeros(THRUSTER_COUNT)
    against[2] = 1.0  # pushes opposite to valve 0
    for faults in (Faults(open=frozenset({0})), Faults(closed=frozenset({2}))):
        assert Bed(5).until_found(lambda: against, faults=faults)[0] == Faults(unknown_push=True)


def test_open_valve_clears_earlier_findings_of_closed_valves():
    bed = Bed(6)
    bed.monitor.faults = Faults(closed=frozenset({2}))
    opened = Faults(open=frozenset({0}))
    assert bed.until_found(lambda: np.zeros(THRUSTER_COUNT), True, faults=opened)[0] == opened


def test_prediction_uses_the_real_state_of_faulty_valves():
    now, ms = 100 * 10**9, 10**6

    def accelerations(on_times, faults=NO_FAULTS):
        inputs = KnownInputs(P, EstimatorSettings(valve_delay=0.0))
        for i, q in enumerate(POSTURE):
            inputs.add_joint_reading(i, now, q, 0.0, 0.0)
        inputs.set_valve_faults(faults)
        inputs.add_pulses(now, on_times)
        return inputs.mean_accelerations([now, now + 50 * ms, now + 100 * ms])[0]

    one, other = 0.1 * np.eye(THRUSTER_COUNT)[[2, 5]]
    faults = Faults(open=frozenset({2}), closed=frozenset({5}))
    np.testing.assert_allclose(
        accelerations(other, faults), accelerations(one), rtol=1e-12, atol=1e-15
    )
    assert np.abs(accelerations(other) - accelerations(one)).max() > 1e-3


@pytest.mark.parametrize(
    "phase", ["reach", *(pytest.param(p, marks=pytest.mark.slow) for p in ("approach", "detumble"))]
)
def test_open_valve_aborts_a_mission_in_time(phase):
    flight = Flight(Case(spin=0.2, heading=3.0, seed=3, fault="open", phase=phase))
    flown = flight.fly()
    assert flown.safe
    assert flown.phases[-1] == "abort"
    assert flight.faults[0][0] < flight.faulted + 8.0
    assert not any(faults.closed for _, faults in flight.faults)
