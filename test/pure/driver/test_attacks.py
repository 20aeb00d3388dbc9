"""Attacks on the way between driver and link: none changes the driver's state or moves the link.

The attacker receives all frames, sends any frame in the name of either side, and can hold
frames back; he has the key of another link, and not of this one.
"""

import pickle
import random
from collections import Counter
from dataclasses import replace
from struct import unpack_from

import pytest
from driver_frames import with_crc

from fss_arm_driver.protocol import LinkCommandFlag, Mode, decode, encode
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_link.protocol import Refused
from fss_link.session import CommandError
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.vehicle import Motion

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
PERIOD, DELAY = SECOND // 5, SECOND // 500
START = 1_700_000_000 * SECOND
LINK = paper_arm().links[0]
REST = Motion(q=0.1, qd=0.0, current=0.0, torque=0.0)


class World:
    """A driver and a link that talk, and a tap that keeps what they said."""

    def __init__(self, number=1, key=KEY, now=START):
        self.session = LinkSession(number, LINK, key=key)
        self.number, self.key, self.now = number, key, now
        self.down, self.up, self.pieces = [], [], []
        self.switch_on(boot=3)

    def switch_on(self, boot):
        self.link = LinkElectronics(self.number, LINK, boot, key=self.key)
        self.born = self.now - 5 * SECOND

    def clock(self):
        return (self.now - self.born) // 1000

    def step(self, down=True, up=True):
        """One period; the sample, if any. What is not delivered is still on the tap."""
        self.now += PERIOD
        self.down.append(self.session.command(self.now))
        self.now += DELAY
        if down:
            self.link.receive(self.down[-1], self.clock())
        for piece in self.session.segments(self.now):
            self.pieces.append(piece)
            self.link.receive(piece, self.clock())
        self.link.demand(self.clock(), REST)
        self.up.append(self.link.telemetry(self.clock(), REST))
        self.now += DELAY
        return self.session.feed(self.up[-1] if up else b"", self.now)

    def run(self, steps, **ways):
        return [self.step(**ways) for _ in range(steps)]

    def armed(self):
        self.run(4)
        self.session.arm(self.now)
        self.run(2)
        assert self.session.armed
        return self

    def moving(self):
        self.armed()
        expiry = self.now + SECOND
        self.session.set(Mode.POSITION, 0.3, 0.0, 0.0, expiry, self.now)
        self.step()
        assert self.link.demand(self.clock(), REST).set_point == pytest.approx(0.3, abs=1e-4)
        return self

    def following(self, number=7):
        """In the middle of a path of 100 s that hardly moves; a next one waits."""
        self.armed()
        times = [2.0 * k for k in range(51)]
        knots = times, [0.1 + 1e-4 * k for k in range(51)], 51 * [0.0]
        self.session.give_path(number, self.now + SECOND, *knots, self.now)
        expiry = self.now + 60 * SECOND
        self.session.set(Mode.PATH, number, 0.0, 0.0, expiry, self.now)
        self.run(40)
        self.session.give_path(number + 1, self.now + 100 * SECOND, *knots, self.now)
        self.run(2)
        assert self.link.paths.following
        assert self.link.demand(self.clock(), REST).mode == Mode.VELOCITY
        return self


def without(counter, thing):
    """Everything that `thing` holds but this count of events, as bytes."""
    kept = Counter(counter)
    counter.clear()
    held = pickle.dumps(thing)
    counter.update(kept)
    return held


def state(world):
    world.session.tick(world.now)
    link, session = world.link, world.session
    return without(session.counts, session), without(link.gate.refused, link)


def patched(data, at, value):
    return with_crc(data[:at] + bytes([value]) + data[at + 1 :])


def flipped(data):
    """Every single bit flipped, the CRC put right."""
    for bit in range(8 * 56):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        yield with_crc(bytes(damaged))


def forged(data, key):
    return encode(decode(data, KEY), key)


def later(data, key=None, **changes):
    """The frame that would come next, signed under another key or none."""
    frame = decode(data, KEY)
    return encode(
        replace(frame, sequence=frame.sequence + 1, clock=frame.clock + 200_000, **changes), key
    )


def another_links(world):
    other = World(number=2, key=OTHER_KEY, now=world.now - 2 * SECOND).armed()
    return other.down, other.up


RNG = random.Random(7)

# What the attacker makes of what he heard (`heard`: the newest last), for either direction.
ON_BYTES = {
    "the last frame again": lambda heard, _: [heard[-1]],
    "all frames again": lambda heard, _: heard,
    "flipped bits": lambda heard, _: flipped(heard[-1]),
    "good CRC, no such signature": lambda heard, _: [later(heard[-1])[:56] + RNG.randbytes(16)],
    "the signature of another frame": lambda heard, _: [later(heard[-1])[:56] + heard[-1][56:]],
    "signed under another link's key": lambda heard, _: [later(heard[-1], OTHER_KEY)],
    "not signed": lambda heard, _: [later(heard[-1])],
    "truncated": lambda heard, _: [heard[-1][:n] for n in range(1, 72)],
    "empty": lambda heard, _: [b""],
    "oversize": lambda heard, _: [later(heard[-1]) + bytes(n) for n in (1, 72, 1400)],
    "two frames in one": lambda heard, _: [heard[-1] + heard[-2]],
    "noise": lambda *_: [RNG.randbytes(72) for _ in range(100)],
    "an older version": lambda heard, _: [patched(later(heard[-1]), 2, 0)],
    "another link's frames": lambda _, others: others,
    "another link's, renumbered": lambda _, others: [patched(data, 4, 1) for data in others],
    "renumbered, signed by its holder": lambda heard, _: [later(heard[-1], OTHER_KEY, link=1)],
}


@pytest.mark.parametrize("name", ON_BYTES)
def test_frames_made_of_what_was_heard_change_nothing(name):
    world = World().moving()
    down, up = another_links(world)
    before = state(world)
    for data in ON_BYTES[name](list(world.up), up):
        assert world.session.feed(data, world.now) is None
    for data in ON_BYTES[name](list(world.down), down):
        assert not world.link.receive(data, world.clock())
    assert state(world) == before
    assert all(world.run(3))
    assert world.session.armed
    assert world.link.armed


@pytest.mark.parametrize("key", [KEY, None])
def test_pieces_of_a_path_from_before_are_refused_after_a_disarm(key):
    world = World(key=key).following()
    recorded = list(world.pieces)
    world.session.disarm()
    world.run(2)
    for data in recorded:
        assert not world.link.receive(data, world.clock())
    assert world.link.gate.refused == {Refused.SEQUENCE if key else Refused.DISARMED: len(recorded)}
    world.session.arm(world.now)
    world.run(3)
    assert world.link.armed
    for data in recorded:
        assert not world.link.receive(data, world.clock())
    if key:
        assert world.link.gate.refused == {Refused.SEQUENCE: 2 * len(recorded)}
        assert world.link.paths.report == 0
    world.run(3)
    assert not world.link.paths.following


def test_what_one_side_said_is_not_taken_by_itself():
    world = World().moving()
    before = state(world)
    for data in world.down:
        assert world.session.feed(data, world.now) is None
    for data in world.up:
        assert not world.link.receive(data, world.clock())
    assert state(world) == before


@pytest.mark.parametrize("pause", [0, 3600 * SECOND])
@pytest.mark.parametrize("restarts", [False, True])
def test_a_recording_is_not_taken_for_a_link_that_went_silent(pause, restarts):
    world = World()
    world.run(50)
    recorded = list(world.up)
    world.run(6, up=False)
    assert world.session.lost
    if restarts:
        world.session = LinkSession(1, LINK, key=KEY)
    world.now += pause
    for data in recorded:
        world.step(up=False)
        assert world.session.feed(data, world.now) is None
    assert world.session.lost
    world.switch_on(boot=4)
    assert any(world.run(3))


def test_frames_of_an_earlier_start_are_refused_by_the_driver():
    world = World()
    world.run(50)
    earlier = list(world.up)
    world.switch_on(boot=4)
    world.run(10)
    assert not world.session.lost
    before = state(world)
    for data in earlier:
        assert world.session.feed(data, world.now) is None
    assert state(world) == before


def test_a_frame_held_back_is_stale():
    world = World()
    world.run(10)
    world.run(4, up=False)
    held = world.up[-4]
    world.step()
    world.now += SECOND
    before = state(world)
    assert world.session.feed(held, world.now) is None
    assert state(world) == before


def test_commands_of_an_earlier_start_of_the_link_neither_arm_nor_shut_the_computer_out():
    world = World().moving()
    earlier = list(world.down)
    world.switch_on(boot=4)
    for data in earlier:
        if world.link.receive(data, world.clock()):
            assert not decode(data, KEY).flags & LinkCommandFlag.ARM
    assert not world.link.armed
    assert world.link.demand(world.clock(), REST).mode == Mode.OFF
    world.run(10)
    assert not world.link.gate.refused[Refused.SEQUENCE]
    assert not world.session.lost


def test_a_link_without_the_driver_s_key_is_named_as_such():
    world = World(key=None)
    world.session = LinkSession(1, LINK, key=KEY)
    world.run(3)
    with pytest.raises(CommandError, match="3 frames without a valid signature: is its key in the"):
        world.session.arm(world.now)


def anew(world):
    world.session = LinkSession(1, LINK, key=KEY)
    world.run(20)


def stopped(world):
    world.session.stop()
    world.run(2)


def armed_again(world):
    stopped(world)
    world.session.arm(world.now)
    world.run(4)
    assert world.link.armed


def silent(world, seconds):
    world.now += seconds * SECOND
    world.link.demand(world.clock(), REST)
    assert world.link.watchdog_tripped


AFTER = {
    "another session": anew,
    "a stop": stopped,
    "a stop and arming": armed_again,
    "3 s of silence": lambda world: silent(world, 3),
    "100 s of silence": lambda world: silent(world, 100),
}


@pytest.mark.parametrize("what", AFTER)
def test_recorded_commands_change_nothing_after(what):
    world = World().moving()
    recorded = world.down
    AFTER[what](world)
    before = without(world.link.gate.refused, world.link)
    for data in recorded:
        assert not world.link.receive(data, world.clock())
    assert without(world.link.gate.refused, world.link) == before


def test_a_command_held_back_beyond_its_time_to_live_is_not_executed():
    world = World().armed()
    world.session.set(Mode.POSITION, 0.3, 0.0, 0.0, world.now + SECOND // 2, world.now)
    world.step(down=False)
    world.now += SECOND // 2
    before = without(world.link.gate.refused, world.link)
    assert not world.link.receive(world.down[-1], world.clock())
    assert without(world.link.gate.refused, world.link) == before


def test_stamps_never_run_back_in_a_session_and_earlier_ones_are_refused():
    world = World().armed()
    world.session.tick(world.now - 3600 * SECOND)
    set_back = world.session.command(world.now - 3600 * SECOND)
    assert world.link.receive(set_back, world.clock())  # the session's stamps never run back
    world.session = LinkSession(1, LINK, key=KEY)
    rolled_back = world.session.command(world.now - 3600 * SECOND)
    assert not world.link.receive(rolled_back, world.clock() + 60_000_000)


def test_a_key_on_one_side_alone_is_heard_by_neither():
    for keys in ((KEY, None), (None, KEY)):
        world = World(key=keys[0])
        world.session = LinkSession(1, LINK, key=keys[1])
        assert not any(world.run(10))
        assert world.link.gate.command is None
        assert world.session.counts["signature"] == 10


def test_the_attacker_has_nothing_but_what_was_said():
    """The attacks above would work, were the key his: the suite can fail."""
    world = World().moving()
    assert unpack_from("<I", world.down[-1], 52)
    assert world.link.receive(later(world.down[-1], KEY, set_point=0), world.clock())
    assert world.link.demand(world.clock(), REST).set_point == 0.0
    world.now += PERIOD
    assert world.session.feed(later(world.up[-1], KEY), world.now)
