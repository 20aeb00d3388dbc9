"""Playback of bags, with outputs and a clock of the test."""

import pytest
from ros_bags import START, STEP, make_bag

from fss_arm_bags.playback import (
    BURST_SIZE,
    MAX_SILENCE,
    MAX_STEP,
    Playback,
    PlaybackError,
    playback_span,
)
from fss_arm_bags.reader import open_bags
from fss_arm_bags.settings import ReplaySettings
from fss_arm_model.units import SECOND

TOPIC = "/joint_states"


class Bench:
    """Outputs of a playback, and real time that advances by one step at each tick."""

    def __init__(self, path, wait_for=None, step=0.002, **settings):
        self.bags, self.time, self.step = open_bags(path), 0.0, step
        self.published, self.clock, self.lines, self.ticks = [], [], [], 0
        self.room, self.acknowledged, self.subscribers = True, True, {TOPIC: 0}
        self.has_duplicate = False
        given = ReplaySettings(**{"discovery": 0.0, **settings})
        span = playback_span(self.bags.span, given.start)
        self.playback = Playback(
            self.bags, span, given, [TOPIC], {}, wait_for or {}, self, lambda: self.time
        )
        self.steps = self.playback.steps()

    def stop_on_duplicate_publisher(self):
        if self.has_duplicate:
            raise SystemExit("also published")

    def publish(self, topic, message):
        if self.room:
            self.published.append((round(self.time, 9), topic, message))
        return self.room

    def publish_clock(self, ns):
        self.clock.append(ns)

    def is_acknowledged(self):
        return self.acknowledged

    def count_subscribers_of(self, name):
        return self.subscribers.get(name)

    def log(self, text):
        self.lines.append(text)

    def run(self, ticks=100_000):
        """Tick until the playback ends or waits for longer."""
        for _ in range(ticks):
            if next(self.steps, self) is self:
                return
            self.ticks += 1
            self.time += self.step


def test_nothing_is_played_beside_another_publisher(tmp_path):
    bench = Bench(make_bag(tmp_path, 5))
    bench.has_duplicate = True
    with pytest.raises(SystemExit, match="also published"):
        bench.run()
    assert bench.published == []


def test_messages_are_played_unchanged_at_their_pace(tmp_path):
    bench = Bench(make_bag(tmp_path, 50), rate=2.0)
    bench.run()
    times, topics, data = zip(*bench.published, strict=True)
    assert set(topics) == {TOPIC}
    assert list(data) == [data for *_, data in bench.bags.raw([TOPIC])]
    expected = [times[0] + k * STEP / SECOND / 2.0 for k in range(50)]
    assert times == pytest.approx(expected, abs=bench.step + 1e-9)
    assert (bench.playback.state, bench.playback.played) == ("done", 50)
    assert bench.playback.progress[0] == pytest.approx(bench.playback.progress[1], abs=0.01)
    assert "50 %" in bench.lines


def test_a_pause_of_the_computer_is_not_made_up_for(tmp_path):
    bench = Bench(make_bag(tmp_path, 50), step=10.0)
    bench.run()
    # At each tick, messages of MAX_STEP; one more tick for the acknowledgement.
    assert bench.ticks == pytest.approx(49 * STEP / SECOND / MAX_STEP, abs=2)


def test_long_silences_are_skipped(tmp_path):
    make_bag(tmp_path, 10)
    make_bag(tmp_path, 10, first=10 + MAX_SILENCE // STEP + 1)
    bench = Bench(tmp_path)
    bench.run()
    assert bench.playback.played == 20
    assert bench.time < 1.0
    assert [line for line in bench.lines if line.endswith("of silence")] == [
        "skipping 10 s of silence"
    ]


def test_a_message_waits_for_room(tmp_path):
    bench = Bench(make_bag(tmp_path, 3), rate=0.0)
    bench.room = False
    bench.run(20)
    assert not bench.published
    bench.room = True
    bench.run()
    assert len(bench.published) == 3


def test_at_full_speed_bursts_are_acknowledged(tmp_path):
    bench = Bench(make_bag(tmp_path, 2 * BURST_SIZE + 1), rate=0.0, step=0.01)
    bench.acknowledged = False
    bench.run(3)
    assert len(bench.published) == BURST_SIZE
    bench.run(50)  # an acknowledgement that does not come delays a burst for a short time only
    assert bench.playback.state == "waiting for acknowledgements"
    bench.acknowledged = True
    bench.run()
    assert bench.playback.state == "done"


@pytest.mark.parametrize(("hold", "state"), [(True, "holding"), (False, "done")])
def test_the_end(tmp_path, hold, state):
    bench = Bench(make_bag(tmp_path, 3), rate=0.0, hold=hold)
    bench.run()
    assert bench.lines[-1] == f"played 3 messages; {state}"
    assert bench.playback.state == state


def test_it_repeats(tmp_path):
    bench = Bench(make_bag(tmp_path, 6), rate=0.0, loop=True, start=0.03)
    while len(bench.published) < 9:
        bench.run(1)
    recorded = [data for *_, data in bench.bags.raw([TOPIC])]
    assert [data for *_, data in bench.published[:9]] == 3 * recorded[3:]
    assert "repeating from the start" in bench.lines


def test_a_repetition_lets_the_node_run(tmp_path):
    """A single message is due at once, so that a pass has nothing to wait for."""
    bench = Bench(make_bag(tmp_path, 1), loop=True)

    def publish(topic, message):
        assert len(bench.published) <= bench.ticks, "it repeats without end in one tick"
        bench.published.append(message)
        return True

    bench.publish = publish
    bench.run(10)
    assert (bench.ticks, len(bench.published)) == (10, 10)


def test_it_waits_for_subscribers(tmp_path):
    bench = Bench(make_bag(tmp_path, 3), {TOPIC: 2}, rate=0.0, deadline=60.0)
    bench.subscribers[TOPIC] = 1
    bench.run(100)
    assert (bench.playback.state, bench.published) == ("waiting for subscribers", [])
    bench.subscribers[TOPIC] = 2
    bench.run()
    assert len(bench.published) == 3


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        (TOPIC, "too few subscribers of /joint_states after 0 s"),
        ("/none", "wait_for: /none is not played"),
    ],
)
def test_missing_subscribers_are_reported(tmp_path, name, reason):
    bench = Bench(make_bag(tmp_path, 3), {name: 1}, deadline=0.2)
    with pytest.raises(PlaybackError, match=reason):
        bench.run()
    assert bench.time < 0.3


def test_without_wait_for_the_discovery_time_passes(tmp_path):
    bench = Bench(make_bag(tmp_path, 3), discovery=1.5)
    bench.run()
    assert bench.published[0][0] == pytest.approx(1.5, abs=0.01)


def test_the_clock_follows_the_times_of_receipt(tmp_path):
    bench = Bench(make_bag(tmp_path, 50), clock=True)
    bench.run()
    assert bench.clock[0] == START
    assert bench.clock == sorted(bench.clock)
    silent = Bench(bench.bags.paths[0])
    silent.run()
    assert not silent.clock


def test_a_start_after_the_end_is_rejected():
    assert playback_span((START, START + SECOND), 0.5) == (START + SECOND // 2, START + SECOND)
    with pytest.raises(ValueError, match=r"start is 9\.0 s, but the bags last only 1\.000 s"):
        playback_span((START, START + SECOND), 9.0)
