"""Frames that reach a link of another vehicle, which has the same number."""

from random import Random

import pytest

from fss_arm_driver.protocol import Command, LinkCommandFlag, Mode, encode
from fss_arm_model.description import paper_arm
from fss_link.protocol import Refused
from fss_sim.link.electronics import LinkElectronics

LINKS = range(1, 5)
KEYS = {v: {i: bytes([v, i]) * 16 for i in LINKS} for v in (1, 2)}
SECOND = 1_000_000


def links(keys=None, boots=(1, 1, 1, 1)):
    arm = paper_arm()
    return [
        LinkElectronics(i, link, boot, key=keys and keys[i])
        for i, link, boot in zip(LINKS, arm.links, boots, strict=True)
    ]


def command(rng, k, i, boot):
    """Return a random command: arm, move, stop, home or clear."""
    flag = LinkCommandFlag
    return Command(
        link=i, flags=rng.choice((0, flag.ARM, flag.STOP, flag.ARM | flag.HOME)), boot=boot,
        sequence=k, clock=SECOND + 1000 * k, expiry=SECOND + 1000 * k + 500, watchdog=2000,
        mode=rng.choice((Mode.OFF, Mode.CURRENT, Mode.VELOCITY, Mode.POSITION)),
        set_point=rng.randrange(-1000, 1000), velocity=rng.randrange(1000), acceleration=1000,
    )  # fmt: skip


@pytest.mark.parametrize("count", [20_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_a_link_rejects_commands_signed_for_another_vehicle(count):
    rng, links_here, links_there = Random(1), links(KEYS[1]), links(KEYS[2])
    for k in range(count):
        i = 1 + k % 4
        link = links_here[i - 1]
        data = encode(command(rng, k, i, link.gate.boot), KEYS[2][i])
        assert not link.receive(data, SECOND + 1000 * k)
        if k % 1000 < 4:  # its addressee accepts it
            links_there[i - 1].receive(data, SECOND + 1000 * k)
    for link in links_here:
        assert link.gate.refused == {Refused.FRAME: count // 4}
        assert not link.armed
        assert link.gate.command is None
    assert all(link.gate.command for link in links_there)


def test_without_keys_only_the_boot_number_distinguishes_vehicles():
    """Reason for the advice in docs/how-to/security.md: each vehicle needs its own keys."""
    first, second = links(boots=(1, 2, 3, 4)), links(boots=(9, 2, 9, 9))
    disarmed = {
        "flags": 0, "sequence": 1, "clock": SECOND, "expiry": 0, "watchdog": 2000,
        "mode": Mode.OFF, "set_point": 0, "velocity": 0, "acceleration": 0,
    }  # fmt: skip
    accepted = [
        first[i - 1].receive(encode(Command(link=i, boot=link.gate.boot, **disarmed)), SECOND)
        for i, link in zip(LINKS, second, strict=True)
    ]
    assert accepted == [False, True, False, False]  # link 2 has the same boot number in both
    assert first[0].receive(encode(Command(link=1, boot=0, **disarmed)), SECOND)  # boot 0: any link
    stop = {**disarmed, "flags": LinkCommandFlag.STOP, "sequence": 2, "clock": SECOND + 1}
    assert first[2].receive(encode(Command(link=3, boot=9, **stop)), SECOND)  # always obeyed
