"""Who receives when, and what is dropped if that is not enough."""

from collections import Counter, deque
from threading import Event

import pytest
from running import wait_until

from fss_link.receiver import NEWEST, Receiver, Turns


class Time:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def work(turns, time, seconds):
    with turns.turn():
        time.now += seconds


def test_who_works_little_never_rests():
    turns = Turns(0.5, 0.1, time := Time())
    for _ in range(1000):
        work(turns, time, 0.004)
        time.now += 0.006
        assert turns.rest() <= 0.0


def test_who_works_all_the_time_rests_for_half_of_it_but_not_at_once():
    turns = Turns(0.5, 0.1, time := Time())
    begun, worked, first = time.now, 0.0, None
    while worked < 10.0:
        if (rest := turns.rest()) > 0.0:
            first = first or time.now - begun
            time.now += rest
        work(turns, time, 0.01)
        worked += 0.01
    assert first == pytest.approx(0.1, abs=0.011)
    assert worked / (time.now - begun) == pytest.approx(0.5, rel=0.02)


class Line:
    """A transport from which frames come in batches."""

    def __init__(self, *batches):
        self.batches, self.counts, self.silent = deque(batches), Counter(), Event()

    def wait(self, timeout):
        if not self.batches:
            self.silent.set()
            Event().wait(0.01)
        return bool(self.batches)

    def receive(self):
        return self.batches.popleft() if self.batches else []


class Behind(Turns):
    """Its time is always used up."""

    def rest(self):
        return 1e-6


def frames(first, count):
    return [bytes([number % 256]) for number in range(first, first + count)]


def received(turns, *batches):
    line, got = Line(*batches), []
    receiver = Receiver(line, got.append, None, turns)
    wait_until(line.silent.is_set, 5.0, lambda: line.silent.wait(0.1))
    receiver.close()
    return got, line.counts["dropped"]


def test_nothing_is_dropped_while_there_is_time():
    got, dropped = received(Turns(0.5, 10.0), frames(0, 64), frames(64, 64), frames(128, 3))
    assert got == [frames(0, 64), frames(64, 64), frames(128, 3)]
    assert dropped == 0


def test_the_newest_are_taken_when_there_is_too_much_and_the_others_counted():
    got, dropped = received(Behind(0.5, 0.1), frames(0, 64), frames(64, 64), frames(128, 3))
    assert got == [frames(131 - NEWEST, NEWEST)]
    assert dropped == 131 - NEWEST
    assert received(Behind(0.5, 0.1), frames(0, 2)) == ([frames(0, 2)], 0)
