"""The session with one link: accepted telemetry, sent commands, loss and adoption."""

import re
from dataclasses import replace
from math import inf, nan, pi

import pytest
from driver_link import MILLISECOND, FakeLink
from driver_link import SessionBench as Bench

from fss_arm_driver.protocol import LinkCommandFlag, Mode, Slow, State, decode, encode
from fss_arm_model.description import Drive, TorqueSensor, paper_arm
from fss_arm_model.units import SECOND
from fss_link.session import Arming, CommandError, StatusLog

PERIOD, DELAY = Bench.PERIOD, Bench.DELAY
LINK = paper_arm().links[0]
COUNTS_PER_RADIAN = 240_000 / (2 * pi)


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def connected(bench):
    return bench.connected()


@pytest.fixture
def armed(connected):
    connected.now += PERIOD // 2
    connected.session.arm(connected.now)
    while not connected.session.armed:
        assert connected.step()
    return connected


def test_the_second_frame_in_a_row_is_believed(bench):
    assert bench.session.lost
    assert bench.step() is None
    sample = bench.step()
    assert sample.frame == bench.link.frame
    assert not bench.session.lost
    assert bench.session.counts["adopted"] == 1


def test_a_sample_is_in_si_units_and_host_time():
    sensor = TorqueSensor(gain=2.1 / 2**23, zero=1000.0)
    bench = Bench(replace(LINK, drive=Drive(direction=-1), torque_sensor=sensor))
    reading = {"position": 60_000, "velocity": -24_000, "torque": 1000 + 2**22}
    bench.step(**reading)
    sample = bench.step(**reading)
    assert sample.position == pytest.approx(-pi / 2, rel=1e-15)
    assert sample.velocity == pytest.approx(2400 * 2 * pi / 240_000)
    assert sample.torque == pytest.approx(1.05)
    measured = bench.now - DELAY
    assert abs(sample.stamp - measured) <= DELAY + 1000
    assert (
        abs(bench.step(**reading).stamp - measured - PERIOD) <= 1000
    )  # equal delays: a clock of 1 us
    assert bench.session.round_trip == pytest.approx(2e-9 * DELAY, abs=2e-6)


NAMED = replace(LINK, serial=7)


def named(*serials, description=NAMED):
    """A link that has told these serial numbers, at a place where another may be expected."""
    bench = Bench(description, file="arm.yaml")
    while bench.step() is None:
        pass
    for serial in serials:
        bench.step(slow_id=Slow.SERIAL, slow_value=serial)
    return bench


def test_a_link_is_armed_once_it_has_told_the_serial_number_expected():
    bench = named()
    why = "link 1 has not yet reported its serial number, expected 7"
    with pytest.raises(CommandError, match=f"^{why}$"):
        bench.session.arm(bench.now)
    bench.step(slow_id=Slow.SERIAL, slow_value=7)
    bench.session.arm(bench.now)
    bench.step()
    bench.step()
    assert bench.session.armed


def test_another_link_is_not_armed_and_is_told_with_the_file_to_change():
    bench = named(8)
    why = (
        "link 1 has faults: serial number is 8, expected 7: "
        "mount that link here or change the links in arm.yaml"
    )
    with pytest.raises(CommandError, match=f"^{why}$"):
        bench.session.arm(bench.now)
    assert not bench.last_command().flags & LinkCommandFlag.ARM


def test_a_link_that_is_swapped_while_armed_is_disarmed():
    bench = named(7)
    bench.session.arm(bench.now)
    bench.step()
    bench.step()
    assert bench.session.armed
    bench.step(slow_id=Slow.SERIAL, slow_value=8)
    assert bench.session.arming is Arming.DISARMED
    assert "serial number is 8" in bench.session.disarm_reason


@pytest.mark.parametrize(("serials", "description"), [((0,), NAMED), ((8,), LINK), ((), LINK)])
def test_without_two_serial_numbers_to_compare_a_link_is_armed(serials, description):
    bench = named(*serials, description=description)
    assert bench.session.obstacle(bench.now) == ""
    assert bool(bench.session.serial_problem) == (description is NAMED)


def test_a_serial_number_is_told_anew_after_a_loss():
    bench = named(7)
    bench.now += 5 * SECOND
    bench.session.tick(bench.now)
    while bench.step() is None:
        pass
    assert "has not yet reported" in bench.session.obstacle(bench.now)


def test_a_pause_at_the_begin_is_not_taken_for_the_usual_period(bench):
    bench.step()
    bench.now += 2 * PERIOD
    for _ in range(5):
        bench.step()
    assert bench.session.counts["accepted"] == 5


def test_damage_repetition_and_disorder_are_counted_and_published_never(connected):
    one = connected.link.telemetry(connected.now + 1 * PERIOD)
    two = connected.link.telemetry(connected.now + 2 * PERIOD)
    assert connected.feed(two, 2 * PERIOD + DELAY)
    before = connected.session.counts.copy()
    flipped = two[:30] + bytes([two[30] ^ 4]) + two[31:]
    own = connected.session.command(connected.now)
    foreign = encode(replace(decode(two), link=2))
    for data in (two, one, two[:-1], b"", two + b"\0", foreign, own, flipped):
        assert connected.feed(data) is None
    new = connected.session.counts - before
    assert new == {"received": 8, "sent": 1, "repeated": 1, "reordered": 1, "length": 3,
                   "foreign": 2, "crc": 1}  # fmt: skip


def test_missed_frames_are_counted(connected):
    connected.step(up=False)
    connected.step(up=False)
    assert connected.step()
    assert connected.session.counts["missed"] == 2


def test_a_delayed_burst_is_taken_in_order_with_its_true_stamps(connected):
    begin = connected.now
    frames = [connected.link.telemetry(begin + k * PERIOD) for k in range(1, 4)]
    connected.now += 3 * PERIOD + DELAY
    stamps = [connected.feed(frame).stamp for frame in frames]
    for k, stamp in enumerate(stamps, 1):
        assert abs(stamp - begin - k * PERIOD) < 1000
    assert not connected.session.lost


def test_a_frame_older_than_the_timeout_is_stale(connected):
    old = connected.link.telemetry(connected.now + 60 * MILLISECOND)
    for _ in range(6):
        connected.step()
    assert connected.feed(old) is None
    assert connected.session.counts["stale"] == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"velocity": round(3.1 * COUNTS_PER_RADIAN * 10)},
        {"current": 460},
        {"position": -round(4.8 * COUNTS_PER_RADIAN)},
    ],
)
def test_what_the_link_cannot_do_is_refused(connected, changes):
    assert connected.step(**changes) is None
    assert connected.session.counts["impossible"] == 1
    assert connected.step()


@pytest.mark.parametrize(
    "jump", [{"position": 57_000}, {"boot": 8}, {"clock": 1 << 60}, {"sequence": 1 << 30}]
)
def test_a_single_jump_is_never_believed(connected, jump):
    assert connected.step(**jump) is None
    assert connected.session.counts["candidates"] == 2
    assert connected.step().frame.boot == 7
    assert connected.session.counts["adopted"] == 1


def test_a_stranger_cannot_displace_a_link_that_talks(connected):
    stranger = FakeLink(boot=9, born=connected.now - 5 * SECOND)
    for _ in range(20):
        assert connected.feed(stranger.telemetry(connected.now), DELAY) is None
        assert connected.step().frame.boot == 7


def test_a_silent_link_is_lost_and_returns_disarmed(armed):
    armed.set(Mode.POSITION, 0.2)
    for _ in range(6):
        armed.step(up=False)
    assert armed.session.lost
    assert armed.session.arming is Arming.DISARMED
    logged = armed.last_command()
    assert (logged.flags, logged.boot, logged.mode) == (0, 0, Mode.OFF)
    assert armed.step()
    assert not armed.session.armed
    assert armed.session.counts["lost"] == 1
    assert armed.session.counts["adopted"] == 2
    assert not armed.last_command().flags & LinkCommandFlag.ARM
    with pytest.raises(CommandError, match="to arm it"):
        armed.set(Mode.POSITION, 0.2)


def test_a_link_lost_for_long_is_adopted_by_its_second_frame(connected):
    connected.now += 70 * SECOND
    assert connected.step() is None
    assert connected.step()


def test_a_rebooted_link_is_adopted_disarmed(armed):
    armed.step(slow_id=Slow.BATTERY)
    armed.set(Mode.POSITION, 0.2)
    armed.restart(boot=8)
    armed.link.take(replace_boot(armed.session.command(armed.now), 0), armed.now)
    silent = 0
    while not (sample := armed.step(down=False)):
        silent += 1
    assert silent == 5  # not before the link it was is lost
    assert sample.frame.boot == 8
    assert not armed.session.armed
    assert armed.session.slow == {Slow.SUPPLY: 240}
    assert armed.last_command().boot == 8
    assert armed.session.arming is Arming.DISARMED


def replace_boot(data, boot):
    return encode(replace(decode(data), boot=boot, flags=0, expiry=0))


def test_a_link_that_reuses_its_boot_number_comes_back(connected):
    connected.restart(boot=7)
    connected.now += 2 * SECOND
    for _ in range(5 * 70):
        if connected.step(down=False):
            break
    assert connected.session.frame == connected.link.frame


def leap(bench, ahead):
    """Let the host's clock leap ahead [ns]; the link's does not."""
    bench.now += ahead
    bench.link.born += ahead
    bench.link.arrived += ahead


@pytest.mark.parametrize("ahead", [2 * SECOND, 59 * SECOND])
def test_a_host_clock_that_leaps_forward_costs_one_frame(armed, ahead):
    leap(armed, ahead)
    samples = [armed.step() for _ in range(10)]
    assert [bool(sample) for sample in samples] == [False] + [True] * 9
    assert abs(armed.now - samples[-1].stamp - DELAY) < DELAY


@pytest.mark.parametrize("ahead", [-30 * SECOND, 3600 * SECOND])
def test_a_host_clock_that_leaps_costs_seconds_not_a_restart(armed, ahead):
    leap(armed, ahead)
    samples = [armed.step() for _ in range(60)]
    assert not armed.session.lost
    assert not armed.session.armed
    assert abs(armed.now - samples[-1].stamp - DELAY) < DELAY


def test_a_homing_that_sets_the_count_does_not_interrupt(armed):
    armed.link.referenced = False
    armed.link.position = 100_000
    while not armed.step():
        pass
    armed.session.arm(armed.now)
    while not armed.session.armed:
        armed.step()
    armed.link.referenced, armed.link.position = True, 0
    assert armed.step().referenced
    assert armed.session.armed
    armed.link.position = 100_000
    assert armed.step() is None  # once is enough


def test_arming_is_told_held_and_confirmed(connected):
    connected.session.arm(connected.now)
    logged = connected.last_command()
    assert logged.flags == LinkCommandFlag.ARM | LinkCommandFlag.HOLD
    assert logged.boot == 7
    assert logged.expiry >= connected.link.clock(connected.now + SECOND - DELAY)
    assert connected.session.arming is Arming.ARMING
    connected.step()
    assert connected.session.armed


def test_a_lost_link_cannot_be_armed(bench):
    with pytest.raises(CommandError, match="link 1 is lost: nothing received yet"):
        bench.session.arm(bench.now)


def test_arming_that_comes_to_nothing_ends(connected):
    connected.session.arm(connected.now)
    for _ in range(12):
        connected.step(down=False)
    assert connected.session.arming is Arming.DISARMED


def test_an_old_confirmation_does_not_arm(armed):
    armed.session.disarm()
    armed.session.arm(armed.now)
    armed.step(down=False)
    assert armed.session.arming is Arming.ARMING


def test_a_command_is_told_in_the_drives_units_until_it_expires(armed):
    armed.set(Mode.POSITION, -0.5, velocity=0.5, acceleration=1.0, time_to_live=0.5)
    logged = armed.last_command()
    assert logged.flags == LinkCommandFlag.ARM
    assert logged.mode == Mode.POSITION
    assert logged.set_point == round(-0.5 * COUNTS_PER_RADIAN)
    assert logged.velocity == round(0.5 * COUNTS_PER_RADIAN * 10)
    assert logged.acceleration == round(1.0 * COUNTS_PER_RADIAN / 10)
    assert abs(logged.expiry - armed.link.clock(armed.now + SECOND // 2)) <= DELAY // 1000
    armed.now += SECOND // 2 + 1
    assert armed.last_command().flags == LinkCommandFlag.ARM | LinkCommandFlag.HOLD


@pytest.mark.parametrize(
    ("mode", "value", "set_point"),
    [
        (Mode.VELOCITY, 5.0, round(COUNTS_PER_RADIAN * 10)),
        (Mode.VELOCITY, -0.1, -round(COUNTS_PER_RADIAN)),
        (Mode.CURRENT, -9.0, -225),
        (Mode.CURRENT, 0.4, 40),
    ],
)
def test_velocity_and_current_are_clamped(armed, mode, value, set_point):
    armed.set(mode, value)
    assert armed.last_command().set_point == set_point
    assert armed.session.counts["commands_clamped"] == (abs(value) > 1.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((Mode.POSITION, 1.6), "set_point is 91.67 deg, expected -90 to 90 deg"),
        ((Mode.POSITION, nan), "set_point is nan, expected a finite number"),
        *(((mode, value), f"set_point is {re.escape(str(value))}, expected")
          for mode in (Mode.CURRENT, Mode.VELOCITY, Mode.POSITION, Mode.PATH)
          for value in (nan, -inf, 1e18)),
        *(((Mode.POSITION, 0.1, *numbers), "max_(velocity|acceleration) is")
          for value in (nan, inf, 1e18, -5e-324)
          for numbers in ((value, 0.0), (0.0, value))),
        ((Mode.POSITION, 0.1, -1.0), "max_velocity is -1.0, expected 0"),
        ((Mode.OFF, 0.0), "mode is 0, expected 1, 2, 11, 21 or 31"),
        ((7, 0.0), "mode is 7"),
        ((Mode.POSITION, 0.1, 0.0, 0.0, -0.1), "expired 0.100 s ago"),
    ],
)  # fmt: skip
def test_commands_that_must_not_be_given_are_refused(armed, arguments, words):
    armed.set(Mode.POSITION, 0.3)
    with pytest.raises(CommandError, match=words):
        armed.set(*arguments)
    assert armed.last_command().set_point == round(0.3 * COUNTS_PER_RADIAN)
    assert armed.session.counts["commands_refused"] == 1


def test_a_joint_at_its_limit_is_not_pushed_on(armed):
    for q in (0.5, 1.0, 1.58):
        armed.link.position = round(q * COUNTS_PER_RADIAN)
        armed.step()
    armed.set(Mode.VELOCITY, 0.5)
    assert armed.last_command().flags & LinkCommandFlag.HOLD
    armed.set(Mode.VELOCITY, -0.5)
    assert not armed.last_command().flags & LinkCommandFlag.HOLD


def test_a_stop_latches_until_armed_anew(armed):
    armed.set(Mode.POSITION, 0.2)
    armed.session.stop()
    assert armed.last_command().flags == LinkCommandFlag.STOP
    armed.step()
    assert armed.link.flags == State.STOPPED
    with pytest.raises(CommandError, match=r"stopped; to arm it: scripts/fss_arm\.sh arm"):
        armed.set(Mode.POSITION, 0.2)
    armed.session.arm(armed.now)
    while not armed.session.armed:
        armed.step()
    assert armed.last_command().flags == LinkCommandFlag.ARM | LinkCommandFlag.HOLD


def test_a_stop_outlives_the_loss_of_the_link(armed):
    armed.session.stop()
    while not armed.session.lost:
        armed.step(up=False)
    assert armed.last_command().flags == LinkCommandFlag.STOP


def test_disarming_is_done_when_the_link_says_that_it_is_off(armed):
    armed.session.disarm()
    armed.step(down=False)  # it does not know yet
    assert not armed.session.settled
    armed.step(mode=Mode.VELOCITY)  # it brakes
    assert not armed.session.settled
    armed.step()
    assert armed.session.settled
    assert armed.session.released
    armed.session.arm(armed.now)
    assert not armed.session.released


def test_that_a_link_was_off_before_does_not_confirm_that_it_was_disarmed(armed):
    armed.session.disarm()
    armed.step(down=False, flags=State.REFERENCED, mode=Mode.OFF)
    assert not armed.session.released


@pytest.mark.parametrize("way", [{"down": False}, {"up": False}, {"mode": Mode.POSITION}])
def test_disarming_that_comes_to_nothing_ends(armed, way):
    armed.session.disarm()
    for _ in range(21):
        armed.step(**way)
    assert armed.session.settled
    assert not armed.session.released


def test_faults_are_not_cleared_again_when_the_clock_was_set_back(connected):
    connected.session.clear_faults(connected.now)
    connected.now -= 3600 * SECOND
    assert connected.last_command().flags == 0


def test_faults_are_cleared_after_a_stop(armed):
    armed.session.stop()
    armed.step()
    armed.session.clear_faults(armed.now)
    assert armed.last_command().flags == LinkCommandFlag.CLEAR_FAULTS


def test_a_link_that_disarmed_itself_is_not_armed_again(armed):
    armed.set(Mode.POSITION, 0.2)
    armed.link.flags = State.WATCHDOG
    armed.step(down=False)
    assert armed.session.arming is Arming.DISARMED
    assert armed.last_command().flags == 0
    armed.step()
    assert armed.link.flags == 0


class LogLines:
    """The words of a session's news, asked for before and after each period."""

    def __init__(self, bench):
        self.bench, self.wakeup = bench, StatusLog(bench.session)

    def __call__(self, periods=1, **how):
        lines = list(self.wakeup(self.bench.now))
        for _ in range(periods):
            self.bench.step(**how)
            lines += self.wakeup(self.bench.now)
        return [line.words for line in lines]


def test_each_change_of_state_is_told_once(bench):
    logged = LogLines(bench)
    assert logged(10) == ["link 1 is connected and disarmed"]
    bench.session.arm(bench.now)
    assert logged(10) == ["link 1 is arming", "link 1 is armed"]
    assert logged(10, up=False) == ["link 1 is lost: silent for 1.2 s; it was armed"]
    assert logged(50, up=False) == []
    assert logged(10) == ["link 1 is connected again after 12.2 s and disarmed"]
    bench.session.arm(bench.now)
    assert logged(10) == ["link 1 is arming", "link 1 is armed"]
    assert logged(slow_id=Slow.FAULTS, slow_value=1 << 9) == [
        "link 1 is disarmed: tracking error",
        "link 1 has a fault: tracking error",
    ]
    assert logged(slow_id=Slow.FAULTS, slow_value=0) == ["link 1 has no fault any more"]
    bench.session.stop()
    assert logged(10) == ["link 1 is stopped"]
    bench.session.disarm()
    assert logged(10) == ["link 1 is disarmed"]


def test_a_loss_between_two_calls_is_told(bench):
    logged, session = LogLines(bench), bench.session
    logged(10)
    session.arm(bench.now)
    logged(10)
    for _ in range(10):
        bench.step(up=False)
    assert session.lost
    while session.lost:
        bench.step()
    words = "link 1 was lost; it was armed; connected again and disarmed"
    assert logged() == [words]
    logged(10, up=False)
    while session.lost:
        bench.step()
    session.arm(bench.now)
    line, *_ = logged()
    assert line.endswith("s; it was disarmed, arming was requested")


def test_a_link_that_was_never_heard_is_told_once(bench):
    logged = LogLines(bench)
    assert logged(20, up=False) == []
    words = "link 1: nothing received yet: is it switched on? Does another driver use it?"
    assert logged(200, up=False) == [words]
    bench.now += 2 * SECOND  # the driver stalls
    assert logged(2, up=False) == []
    assert bench.session.stall
    assert logged(2) == ["link 1 is connected and disarmed"]


def test_a_watchdog_that_trips_and_a_link_that_does_not_arm_are_told(armed):
    logged = LogLines(armed)
    assert logged(5) == ["link 1 is connected and armed"]
    assert logged(3, down=False, flags=State.WATCHDOG) == [
        "link 1 is disarmed: link 1 has disarmed itself",
        "link 1: its watchdog tripped, as it received no commands",
    ]
    armed.session.arm(armed.now)
    assert logged(30, down=False, flags=0) == ["link 1 is arming", "link 1 did not arm"]
    words = "link_1 is disarmed: not referenced; it did not confirm in time, try again"
    assert armed.session.describe_outcome(True) == (False, words)
