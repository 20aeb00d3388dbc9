"""Turns of the receivers, and frames dropped under overload."""

from collections import Counter, deque
from threading import Event

import pytest
from running import wait_until

from fss_link.receiver import OVERLOAD_FRAMES, Receiver, TurnScheduler


class Time:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def work(scheduler, time, seconds):
    with scheduler.turn():
        time.now += seconds


def test_a_light_load_never_waits():
    scheduler = TurnScheduler(0.5, 0.1, time := Time())
    for _ in range(1000):
        work(scheduler, time, 0.004)
        time.now += 0.006
        assert scheduler.wait_time() <= 0.0


def test_a_full_load_waits_half_of_the_time_after_the_burst():
    scheduler = TurnScheduler(0.5, 0.1, time := Time())
    start, worked, first = time.now, 0.0, None
    while worked < 10.0:
        if (rest := scheduler.wait_time()) > 0.0:
            first = first or time.now - start
            time.now += rest
        work(scheduler, time, 0.01)
        worked += 0.01
    assert first == pytest.approx(0.1, abs=0.011)
    assert worked / (time.now - start) == pytest.approx(0.5, rel=0.02)


class BatchTransport:
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


class Overloaded(TurnScheduler):
    """Scheduler whose share is always used up."""

    def wait_time(self):
        return 1e-6


def frames(first, count):
    return [bytes([number % 256]) for number in range(first, first + count)]


def received(scheduler, *batches):
    line, got = BatchTransport(*batches), []
    receiver = Receiver(line, lambda *given: got.append(given), None, scheduler)
    wait_until(line.silent.is_set, 5.0, lambda: line.silent.wait(0.1))
    receiver.close()
    return got, line.counts["dropped"]


def test_nothing_is_dropped_while_there_is_time():
    got, dropped = received(TurnScheduler(0.5, 10.0), frames(0, 64), frames(64, 64), frames(128, 3))
    assert got == [(each, False) for each in (frames(0, 64), frames(64, 64), frames(128, 3))]
    assert dropped == 0


def test_under_overload_the_newest_frames_are_processed_and_the_others_counted():
    got, dropped = received(Overloaded(0.5, 0.1), frames(0, 64), frames(64, 64), frames(128, 3))
    assert got == [(frames(131 - OVERLOAD_FRAMES, OVERLOAD_FRAMES), True)]
    assert dropped == 131 - OVERLOAD_FRAMES
    assert received(Overloaded(0.5, 0.1), frames(0, 2)) == ([(frames(0, 2), True)], 0)
