"""A million random and mutated datagrams at a driver while its true link keeps sending.

Half of the damaged frames have a corrected CRC, as if an attacker had forged them at the link's own
address. Without a signature a forged frame that a link could have sent cannot be distinguished from
a true one; what is published must then still follow from the frames before, by the rules of
docs/reference/protocol.md. The judge below knows the truth and the published bounds, not the
implementation.
"""

import random
from dataclasses import replace
from math import pi, sin

import pytest
from driver_link import FakeLink
from firmware_vectors import damaged
from running import memory

from fss_arm_driver.messages import SampleMessages
from fss_arm_driver.protocol import decode, encode
from fss_arm_driver.session import COUNTS, LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND

FRAME_INTERVAL = 20  # datagrams from one true frame to the next
PERIOD = SECOND // 5
COUNTS_PER_RADIAN = 240_000 / (2 * pi)


def truth(seconds):
    """The joint's angle [rad]: it swings with up to 0.7 rad/s."""
    return 1.4 * sin(0.5 * seconds)


def damage(rng, true_frames, ahead):
    """One datagram: noise, a repetition, or a true frame damaged; half with a new CRC."""
    kind = rng.random()
    if kind < 0.1:
        return rng.randbytes(rng.randint(0, 100))
    frame = ahead if kind > 0.995 else rng.choice(true_frames)
    return frame if kind < 0.2 else damaged(rng, frame, None)


class Judge:
    """Holds each published sample against the truth."""

    def __init__(self):
        self.sent = {}  # true frames: time of measurement
        self.exact = self.forged = 0
        self.anchor = None  # stamp and position of the last true sample
        self.since = 0  # forged ones since then

    def check(self, sample, now):
        assert -0.15 * SECOND <= now - sample.stamp <= SECOND
        measured = self.sent.pop(sample.frame, None)
        if measured is not None:
            assert abs(sample.stamp - measured) < 0.15 * SECOND
            assert abs(sample.position - truth(measured / SECOND)) < 1.0 / COUNTS_PER_RADIAN
            self.anchor, self.since = (sample.stamp, sample.position), 0
            self.exact += 1
            return
        self.forged += 1
        self.since += 1
        stamp, position = self.anchor
        reach = 3.0 * (abs(sample.stamp - stamp) / SECOND + 0.1) + 0.01 * self.since
        assert abs(sample.position - position) <= reach
        assert abs(sample.velocity) <= 3.0
        assert abs(sample.position) <= 1.5 * pi


@pytest.mark.parametrize("datagrams", [30_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_damaged_datagrams(datagrams):
    rng = random.Random(20)
    session = LinkSession(1, paper_arm().links[0])
    messages = SampleMessages(session)
    link, judge = FakeLink(boot=3), Judge()
    recent, ahead, now, before = [], b"", SECOND, 0
    for k in range(datagrams):
        now += PERIOD // FRAME_INTERVAL
        if k % FRAME_INTERVAL == 0:
            link.take(session.command(now), now)
            link.position = round(truth(now / SECOND) * COUNTS_PER_RADIAN)
            data = link.telemetry(now)
            recent = [*recent[-15:], data]
            judge.sent[decode(data)] = now
            then = link.clock(now + PERIOD)
            ahead = encode(replace(link.frame, sequence=link.frame.sequence + 1, clock=then))
        else:
            data = damage(rng, recent, ahead)
        if sample := session.feed(data, now):
            assert not session.armed
            judge.check(sample, now)
            messages.joint_state(sample)
            messages.telemetry(sample, now)
        if k == datagrams // 5:
            before = memory()
    counts = session.counts
    assert memory() - before < 4_000_000
    assert tuple(counts) == COUNTS
    assert counts["received"] == datagrams
    assert judge.exact > 0.9 * datagrams / FRAME_INTERVAL
    assert 0 < judge.forged < 0.1 * judge.exact  # some damaged frames came before the true one
