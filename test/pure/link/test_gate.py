"""Acceptance of commands by a link and the base's board: once, in order, in time and signed."""

from dataclasses import replace
from functools import partial

import base_board
import pytest
from driver_frames import BOOT, DISARM, KEY, MOVE, SECOND

from fss_arm_driver import protocol as links
from fss_base_driver import protocol as board
from fss_link.protocol import CommandFlag, Refused

HOUR = 3600 * SECOND


class Door:
    """The gate of one kind of electronics, with a command that disarms and one that arms."""

    def __init__(self, protocol, gate, disarm, arm, key):
        self.protocol, self.gate, self.key = protocol, gate(BOOT, key), key
        self.disarm, self.arm = disarm, replace(arm, clock=6, expiry=1 << 63)
        self.stop = replace(disarm, flags=CommandFlag.STOP)

    def accepts(self, command, at=SECOND, signed=True, **changes):
        """Return True if a command with these changes is accepted."""
        data = self.protocol.encode(replace(command, **changes), self.key if signed else None)
        return self.gate.accept(data, at) is not None

    def start_session(self):
        """Send a command that disarms, then one that arms."""
        assert self.accepts(self.disarm)
        assert self.accepts(self.arm)
        return self


DOORS = {
    "link": partial(Door, links, partial(links.link_gate, 2), DISARM, MOVE),
    "board": partial(Door, board, board.board_gate, base_board.QUIET, base_board.GO),
}


@pytest.fixture(params=DOORS)
def door(request):
    return DOORS[request.param](key=None)


@pytest.fixture(params=DOORS)
def signed(request):
    return DOORS[request.param](key=KEY)


@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize("kind", DOORS)
@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, Refused.SEQUENCE),  # the same again
        ({"sequence": 1}, Refused.SEQUENCE),
        ({"sequence": 0xFFFFFFF0}, Refused.SEQUENCE),
        ({"sequence": 3, "boot": BOOT + 1}, Refused.BOOT),
        ({"sequence": 3, "expiry": SECOND - 1}, Refused.EXPIRED),
    ],
)
def test_what_is_refused_changes_nothing_and_is_counted_by_its_reason(kind, key, changes, reason):
    door = DOORS[kind](key=key).start_session()
    assert not door.accepts(door.arm, **{"clock": 7, **changes})
    assert door.gate.refused == {reason: 1}
    assert (door.gate.command, door.gate.arrival) == (door.arm, SECOND)
    assert door.accepts(door.arm, sequence=3, clock=7)


def test_what_is_no_command_to_it_is_refused(door):
    data = door.protocol.encode(door.disarm)
    for wrong in (b"", data[:1], data[:71], data + b"\0"):
        assert door.gate.accept(wrong, SECOND) is None
    assert door.gate.refused == {Refused.FRAME: 4}


def test_a_link_refuses_what_is_for_another_and_both_what_electronics_say():
    link, base = (make(key=None) for make in DOORS.values())
    assert not link.accepts(link.disarm, link=3)
    said = replace(base_board.SAMPLE, boot=BOOT)
    assert base.gate.accept(board.encode(said), SECOND) is None
    assert link.gate.refused == base.gate.refused == {Refused.OTHER: 1}


def test_a_session_cannot_begin_armed_not_even_after_silence(door):
    assert not door.accepts(door.arm)
    door.start_session()
    late = SECOND + door.gate.watchdog + 1
    assert not door.accepts(door.arm, late, sequence=3)
    assert door.accepts(door.disarm, late, sequence=1)
    assert door.accepts(door.arm, late, sequence=2)


def test_a_stop_is_obeyed_whatever_its_boot_and_sequence(door):
    door.start_session()
    assert door.accepts(door.stop, sequence=0, boot=BOOT + 5)
    assert door.accepts(door.arm, sequence=3)  # and is no part of the session's order


def test_with_a_key_each_command_is_taken_once_and_only_if_signed(signed):
    commands = [signed.disarm, signed.arm, replace(signed.stop, sequence=3, clock=7)]
    for count, command in enumerate(commands, 1):
        assert not signed.accepts(command, signed=False)
        assert signed.accepts(command)
        assert not any(signed.accepts(earlier) for earlier in commands[:count])
    assert signed.gate.refused == {Refused.FRAME: 3, Refused.SEQUENCE: 6}


@pytest.mark.parametrize("flags", [0, CommandFlag.STOP])
def test_with_a_key_nothing_recorded_is_taken_after_a_silence(signed, flags):
    signed.start_session()
    recorded = replace(signed.disarm, flags=flags, sequence=9)
    for stamp in (5, 6):
        assert not signed.accepts(recorded, HOUR, clock=stamp)
    assert signed.accepts(recorded, HOUR, clock=7)
