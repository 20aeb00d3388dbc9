"""Echoes: two drivers of one link, the order of signed commands, delay, stalls."""

from dataclasses import replace

import pytest
from driver_world import DATE, LINK, PERIOD, WATCHDOG, World

from fss_arm_driver.protocol import LinkCommandFlag, Mode, State, decode, encode
from fss_arm_driver.session import LinkSession
from fss_arm_model.units import SECOND
from fss_link.session import Arming, CommandError
from fss_link.session.echoes import MAX_STAMP_LEAD, STAMP_SPREAD
from fss_sim.link.electronics import LinkElectronics

HOUR = 3600.0
KEY = bytes(range(32))
both = pytest.mark.parametrize("key", [None, KEY])


def turning(key, seconds=60.0):
    """A world, and its driver whose link turns for that time [s]."""
    world = World(key)
    session = world.driver()
    world.run(3.0)
    world.turn(world.arm(session), seconds)
    return world, session


# --- two drivers ---


@both
@pytest.mark.parametrize("step", [-HOUR, HOUR])
def test_a_second_driver_of_a_link_does_not_disturb_the_first_and_both_notice(key, step):
    world, first = turning(key)
    second = world.driver(step)
    taken = len(world.commands)
    for _ in range(1000):
        world.step()
        assert first.armed
        assert world.turns()
    assert len(world.commands) - taken > 40
    assert not first.other_driver  # it still commands the link
    assert "another sender: does a second driver run, or" in first.link_problem
    assert second.other_driver == "another driver commands link 1"
    with pytest.raises(CommandError, match="another driver commands link 1"):
        second.arm(world.now)
    second.stop()  # any driver may; signed, not with a clock behind
    world.send(second)
    world.run(0.5 if key is None else 1.5)  # with a key the first driver loses the link
    assert world.link.stopped == (key is None or step >= 0.0)
    assert first.armed != world.link.stopped
    world.kill(second)
    world.run(5.0)
    assert not first.link_problem
    world.turn(world.arm(first))


@both
def test_when_the_first_driver_is_gone_the_second_has_the_link(key):
    world, first = turning(key)
    second = world.driver()
    world.run(4.0)
    world.kill(first)
    assert world.run(9.0, lambda: world.can_arm(second)) < WATCHDOG + 2.5
    assert not world.link.armed
    world.arm(second)


@both
def test_a_driver_that_lost_its_link_to_another_disarms_and_says_so(key):
    world = World(key)
    first, second = world.driver(), LinkSession(1, LINK, key=key, epoch=DATE)
    world.run(3.0)
    world.arm(first)
    for _ in range(300):  # commands that the link takes for newer, as of an older session
        second.command(world.now)
    world.drivers.append([second, world.now])
    world.run(1.0 if key is None else 2.0, lambda: first.other_driver)
    assert first.other_driver
    assert first.arming is Arming.DISARMED


def test_a_driver_whose_link_another_keeps_armed_disarms_and_says_so():
    """Only the echoes show it: telemetry says that the link is armed, and it is not lost."""
    world, first = turning(None)
    order = decode(world.commands[-1])
    for k in range(10):
        command = replace(order, sequence=1000 + k, clock=order.clock + 1 + k)
        world.link.receive(encode(command), world.clock())
        world.run(0.2)
        assert world.link.armed
    assert not first.lost
    assert first.arming is Arming.DISARMED
    assert first.disarm_reason == first.other_driver == "another driver commands link 1"


@both
def test_a_driver_that_starts_again_does_not_take_itself_for_another(key):
    world = World(key, delay=0.3)
    first = world.driver()
    world.run(4.0)
    world.arm(first)
    world.kill(first)
    second = world.driver()
    for _ in range(2000):
        world.step()
        assert not second.other_driver
        assert not second.link_problem
    assert world.can_arm(second)


def test_single_strange_echoes_and_the_echo_of_an_old_command_are_no_driver():
    world = World()
    session = world.driver()
    world.run(80.0)
    world.arm(session)
    old = decode(world.commands[0]).clock & 0xFFFFFFFF  # no longer remembered
    echoes = session.echoes
    for frame in map(decode, world.heard[-20:]):
        echoes.update(replace(frame, echo=old, turnaround=75_000_000), world.now)
        assert not echoes.has_other_driver(world.now)
    forged = replace(frame, echo=12345, turnaround=1000)
    echoes.update(forged, world.now)
    assert not echoes.has_other_driver(world.now)
    echoes.update(forged, world.now + SECOND)
    assert echoes.has_other_driver(world.now + SECOND)
    assert not echoes.has_other_driver(world.now + 4 * SECOND)


# --- a clock that was set, and a driver that started again ---


@both
@pytest.mark.parametrize("pause", [0.0, 5000.0])
@pytest.mark.parametrize("step", [-HOUR, 30.0])
def test_a_driver_that_starts_again_after_the_clock_was_set_has_the_link_in_5_s(key, step, pause):
    world, first = turning(key)
    world.kill(first)
    world.run(WATCHDOG + 0.1 if pause else 0.0)
    world.now += round(pause * SECOND)
    second = world.driver(step)
    assert world.run(9.0, lambda: world.can_arm(second)) < 5.0
    world.turn(world.arm(second))
    orders = [decode(data, key).clock for data in world.commands]
    taken = orders.index(world.link.gate.command.clock)
    if key:
        assert orders[taken] > max(orders[: orders.index(orders[taken])])


@pytest.mark.parametrize(("hours", "found"), [(23.5, True), (50.0, False)])
def test_a_day_is_made_up_for_in_seven_seconds_and_more_is_not(hours, found):
    world = World(KEY)
    first = world.driver(hours * HOUR)
    world.run(3.0)
    world.kill(first)
    second = world.driver()
    assert (world.run(20.0, lambda: world.can_arm(second)) < 7.0) == found
    assert second.lost != found


def test_old_telemetry_played_again_costs_a_day_at_most_and_executes_nothing():
    world, first = turning(KEY)
    world.kill(first)
    world.run(10.0)
    commands, heard = list(world.commands), list(world.heard)
    world.link = silent = LinkElectronics(1, LINK, boot=6, key=KEY)
    silent.telemetry = lambda *_: None
    second = world.driver()
    for data in heard * 20:
        world.to_drivers(data)
        world.run(0.05)
    latest = decode(world.commands[-1], KEY).clock
    assert latest <= (world.now + DATE) // 1000 + MAX_STAMP_LEAD
    assert second.lost
    del silent.telemetry
    assert world.run(5.0, lambda: world.can_arm(second)) < 5.0
    world.arm(second)
    for data in commands:
        world.to_link(data)
        assert not world.turns()
    assert world.link.gate.command.clock > latest


def test_a_way_that_is_down_for_an_hour_does_not_use_up_the_order():
    world = World(KEY)
    world.driver()
    world.run(5.0)
    world.to_link = lambda _: None
    world.run(150.0)
    assert decode(world.commands[-1], KEY).clock <= (world.now + DATE) // 1000


# --- echoes as proof ---


@both
def test_a_link_that_hears_nothing_for_minutes_is_still_believed(key):
    world = World(key)
    session = world.driver()
    world.run(3.0)
    world.to_link = lambda _: None
    world.run(150.0)
    assert not session.lost
    believed = session.counts["accepted"]
    world.run(10.0)
    assert session.counts["accepted"] == pytest.approx(believed + 50, abs=1)


def test_sessions_of_the_same_simulated_time_draw_other_stamps():
    sessions = [LinkSession(1, LINK, key=KEY) for _ in range(2)]
    times = range(SECOND, 21 * SECOND, PERIOD)
    one, other = ([decode(s.command(t), KEY).clock for t in times] for s in sessions)
    assert all(0 <= t // 1000 - stamp <= STAMP_SPREAD for t, stamp in zip(times, one, strict=True))
    assert one == sorted(set(one))
    assert len(set(one) & set(other)) < 3  # of 100, each with 1 in 50,000


def test_a_stop_is_stamped_after_what_other_drivers_sent_before_it():
    session = LinkSession(1, LINK, key=KEY)
    session.stop()
    stamps = [decode(session.command(t), KEY).clock for t in (SECOND, SECOND, 2 * SECOND)]
    assert stamps == [1_000_000, 1_000_001, 2_000_000]


# --- delay ---


@both
@pytest.mark.parametrize("delay", [0.0, 0.49])
def test_up_to_half_a_second_each_way_a_link_can_be_armed_turned_and_armed_again(key, delay):
    world = World(key, delay)
    session = world.driver()
    world.run(8.0)
    world.arm(session)
    expiry = world.now + 60 * SECOND
    session.set(Mode.VELOCITY, 0.1, 0.0, 0.0, expiry, world.now)
    world.run(delay + 0.3)
    for _ in range(600):
        world.step()
        assert session.armed
        assert world.turns()
    session.stop()
    world.send(session)
    world.run(2.0)
    assert world.link.stopped
    world.arm(session)


@both
@pytest.mark.parametrize("delay", [0.55, 2.0])
def test_beyond_that_it_is_refused_and_the_delay_is_said(key, delay):
    world = World(key, delay)
    session = world.driver()
    world.run(12.0)
    words = rf"round trip of {2 * delay:.1f}\d s, at most 1 s allowed: is the computer"
    with pytest.raises(CommandError, match=words):
        session.arm(world.now)
    assert session.link_problem


@both
@pytest.mark.parametrize(("delay", "since"), [(0.0, 0.1), (0.9, 1.0), (2.0, 5.0)])
def test_a_stop_takes_effect_after_one_way_whatever_the_delay(key, delay, since):
    world, session = turning(key)
    world.delay = delay
    world.run(since)
    session.stop()
    assert world.run(5.0, lambda: world.link.stopped) <= delay + 0.21
    assert not world.turns()


# --- a stalled process ---


@both
@pytest.mark.parametrize("still", [2.3, 3600.0])
def test_a_driver_that_stood_still_starts_from_rest(key, still):
    world, session = turning(key, 7200.0)
    world.drivers.clear()
    world.run(min(still, 5.0))  # the link receives nothing
    world.now += round((still - min(still, 5.0)) * SECOND)
    waiting = world.heard[-1]
    assert decode(waiting, key).flags & State.WATCHDOG
    world.drivers.append([session, world.now])
    told = decode(session.command(world.now), key)
    assert not told.flags & LinkCommandFlag.ARM
    assert session.progress.reason == f"was stalled for {still:.1f} s"
    session.feed(waiting, world.now)
    with pytest.raises(CommandError, match="link 1"):
        session.arm(world.now)  # asked for before, and only heard now
    for _ in range(1000):
        world.step()
        assert not world.link.armed
    world.arm(session)


def test_a_stop_outlives_a_standstill():
    world = World()
    session = world.driver()
    world.run(3.0)
    world.arm(session)
    session.stop()
    world.now += 10 * SECOND
    assert decode(session.command(world.now)).flags == LinkCommandFlag.STOP
