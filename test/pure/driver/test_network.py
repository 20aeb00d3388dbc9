"""A driver and a link over a bad network, in virtual time: what is stamped, published, executed.

20% of the datagrams are lost, the others take 50 +- 40 ms, some come twice, some 0.3 s late, so
that later ones overtake them; for half a minute nothing comes at all.
"""

from math import sin, sqrt
from random import Random

import pytest
from driver_network import Network
from driver_world import World

from fss_arm_driver.protocol import LinkCommandFlag, Mode
from fss_arm_model.units import SECOND
from fss_link.session import CommandError
from fss_sim.plant.vehicle import Motion

TIMEOUT = SECOND
KEY = bytes(range(16))


class SwingingWorld(World):
    """A world in which the joint swings."""

    def motion(self):
        return Motion(q=sin(0.5e-9 * self.now), qd=0.5, current=0.1, torque=0.0)


@pytest.mark.parametrize(("seed", "key"), [(1, None), (2, KEY)])
def test_a_bad_network(seed, key):
    network = Network(rng=Random(seed))
    world = SwingingWorld(key, network=network, drift=40e-6, tick=SECOND // 500)
    session = world.driver()
    world.run(10.0)
    session.arm(world.now)
    world.run(2.0)
    for k in range(250):
        expiry = world.now + SECOND // 2
        try:
            session.set(Mode.POSITION, 0.2 + 0.001 * k, 0.0, 0.0, expiry, world.now)
        except CommandError:
            session.arm(world.now)  # disarmed by a second of silence: armed again
        world.run(0.2)
    before = len(world.samples)
    network.down = True
    world.run(30.0)
    network.down = False
    assert session.lost
    assert not world.link.armed
    back = world.now
    world.run(30.0)

    assert world.samples[before][0] - back < SECOND
    assert not session.armed
    sequences = [sample.frame.sequence for _, sample in world.samples]
    assert sequences == sorted(set(sequences))
    assert len(sequences) > 0.7 * 5 * 92
    errors = []
    for heard, sample in world.samples:
        when, q = world.measured[sample.frame.sequence]
        assert sample.position == pytest.approx(q, abs=1e-4)
        assert heard - when <= TIMEOUT
        errors.append((sample.stamp - when) / SECOND)
    assert sqrt(sum(error**2 for error in errors) / len(errors)) < 5e-3
    stamps = [sample.stamp for _, sample in world.samples]
    assert stamps == sorted(set(stamps))

    executed = [(clock, c) for clock, c in world.taken if c.flags & LinkCommandFlag.ARM]
    assert len(executed) > 100
    assert all(clock <= command.expiry for clock, command in executed)
    order = [command.sequence for _, command in world.taken]
    assert order == sorted(set(order))
