"""The session with the base's board: pulses counted, orders expired, loss, another's traces."""

from math import inf, nan

import pytest
from base_link import FakeBoard

from fss_arm_model.units import SECOND
from fss_base_driver.messages import BoardHealth
from fss_base_driver.protocol import BaseSlow, BaseState, Gripper, Limits
from fss_base_driver.session import BoardSession
from fss_link.session import Arming, CommandError

PERIOD, DELAY = SECOND // 20, SECOND // 500
START = 1_700_000_000 * SECOND


class Bench:
    """A session and a board, with time."""

    def __init__(self, **options):
        self.key = options.get("key")
        self.session, self.now = BoardSession(**options), START
        self.restart()

    def restart(self, boot=7, **options):
        self.board = FakeBoard(boot, self.now - SECOND, self.key, **options)

    def step(self, down=True, up=True, period=PERIOD):
        """One period: a command down, telemetry up; what is believed."""
        self.now += period - 2 * DELAY
        data = self.session.command(self.now)
        if down:
            self.board.take(data, self.now + DELAY)
        frame = self.board.telemetry(self.now + DELAY)
        self.now += 2 * DELAY
        return self.session.feed(frame, self.now) if up else self.session.tick(self.now)

    def thrust(self, *on_times, age=0.0):
        times = (*on_times, *(8 - len(on_times)) * [0.0])
        self.session.thrust(times, self.now - round(age * SECOND), self.now)

    def last_command(self):
        return self.board.taken[-1]

    def arm(self):
        self.session.arm(self.now)
        for _ in range(10):
            self.step()
        assert self.session.armed
        return self


@pytest.fixture
def bench():
    bench = Bench()
    for _ in range(3):
        bench.step()
    assert not bench.session.lost
    return bench


@pytest.fixture
def armed(bench):
    return bench.arm()


def test_nothing_is_opened_unarmed(bench):
    for call in (lambda: bench.thrust(0.1), lambda: bench.session.grip(True, bench.now)):
        with pytest.raises(CommandError, match=r"to arm it: scripts/fss_arm\.sh valves"):
            call()
    bench.step()
    assert bench.last_command().flags == 0
    assert bench.board.state.opened == 8 * [0]


def test_a_pulse_opens_its_valves_once_however_often_it_is_sent(armed):
    armed.thrust(0.02, 0.0, 0.1)
    for _ in range(12):
        armed.step()
    assert armed.board.state.opened == [20_000, 0, 100_000, 0, 0, 0, 0, 0]
    pulses = [command.pulse for command in armed.board.taken]
    assert pulses.count(1) >= 9  # repeated while it lives
    assert pulses[-1] == 0


def test_a_pulse_longer_than_the_lifetime_is_not_cut(armed):
    armed.thrust(0.9)
    for _ in range(25):
        armed.step()
    assert armed.board.state.opened[0] == 900_000


def test_another_set_takes_the_next_number_and_65535_is_followed_by_1(armed):
    numbers = []
    for before in (None, None, 65535):
        armed.session._number = before or armed.session._number
        armed.thrust(0.1 + 0.1 * len(numbers))
        numbers.append(armed.session.pulse.number)
    assert numbers == [1, 2, 1]


@pytest.mark.parametrize("least", [0.0, 5e-324])
def test_zeros_and_denormal_times_close_at_once(armed, least):
    armed.thrust(1.0)
    armed.step()
    assert armed.board.valves(armed.now) == 1
    armed.thrust(*8 * [least])
    armed.step()
    assert armed.board.valves(armed.now) == 0
    assert armed.session.armed


@pytest.mark.parametrize(
    ("on_times", "words"),
    [
        *((k * (0.0,) + (value,), "on times are .*, expected 8 from 0 to 1 s")
          for k in (0, 7) for value in (nan, inf, -inf, 1e18, -1e18, -5e-324)),
        ((-1e-3,), "on times are .*-0.001.*, expected 8"),
        ((1.001,), "on times are .*1.001.*, expected 8 from 0 to 1 s"),
        (9 * (0.1,), "expected 8"),
    ],
)  # fmt: skip
def test_impossible_times_are_refused_and_change_nothing(armed, on_times, words):
    armed.thrust(0.5)
    before = armed.session.pulse
    with pytest.raises(CommandError, match=words):
        armed.thrust(*on_times)
    assert armed.session.pulse == before


def test_an_old_command_is_refused(armed):
    with pytest.raises(CommandError, match=r"the command is 0\.600 s old"):
        armed.thrust(0.1, age=0.6)


def test_a_pulse_held_back_beyond_its_lifetime_does_not_begin(armed):
    armed.thrust(0.1)
    late = armed.session.command(armed.now)
    for _ in range(8):
        armed.step(down=False)
    armed.now += SECOND // 5
    armed.board.take(late, armed.now)
    assert armed.board.state.opened[0] == 0


def test_stop_closes_and_latches_until_armed_anew(armed):
    armed.thrust(1.0)
    armed.step()
    armed.session.stop()
    armed.step()
    assert armed.board.valves(armed.now) == 0
    assert armed.board.state.flags() == BaseState.STOPPED
    assert armed.session.arming is Arming.STOPPED
    armed.arm()
    assert armed.session.pulse.number == 0
    armed.step()
    assert armed.board.valves(armed.now) == 0


def test_a_new_driver_counts_on_from_the_boards_pulse(armed):
    armed.thrust(0.1)
    armed.step()
    board = armed.board
    again = Bench(epoch=SECOND)
    again.board, again.now = board, armed.now + SECOND
    for _ in range(3):
        again.step()
    again.arm()
    again.thrust(0.1)
    assert again.session.pulse.number == 2
    again.step()
    assert board.valves(again.now) == 1


def test_a_spent_board_disarms_the_driver_and_is_armed_anew():
    bench = Bench()
    bench.restart(limits=Limits(total=200_000))
    for _ in range(3):
        bench.step()
    bench.arm().thrust(1.0)
    for _ in range(6):
        bench.step()
    assert bench.session.arming is Arming.DISARMED
    bench.step()
    assert bench.board.state.opened[0] == 200_000
    bench.arm()


def test_the_gripper_is_told_until_it_says_so_and_not_again(armed):
    armed.session.grip(True, armed.now)
    armed.step()
    armed.step()
    assert armed.board.state.gripper is Gripper.CLOSE
    armed.step()
    armed.step()
    assert armed.last_command().gripper == Gripper.KEEP
    armed.session.stop()
    armed.step()
    armed.arm()
    assert armed.board.state.gripper is Gripper.CLOSE
    armed.session.grip(False, armed.now)
    armed.step()
    assert armed.board.state.gripper is Gripper.OPEN


def test_a_pulse_is_reported_as_it_starts_and_when_it_is_ended_early(armed):
    session = armed.session
    armed.thrust(0.1)
    begin = armed.now
    assert session.take_pulse_change(begin) == pytest.approx([0.1, *7 * [0.0]])
    assert session.take_pulse_change(begin) is None
    armed.thrust()
    assert session.take_pulse_change(begin + SECOND // 10 - 1) == 8 * [0.0]
    assert session.take_pulse_change(begin + SECOND // 10 - 1) is None
    armed.thrust(0.1)
    assert session.take_pulse_change(begin)
    armed.thrust()
    assert session.take_pulse_change(begin + SECOND // 10) is None  # ended by itself


def test_state_and_outcome_of_arming_are_put_in_words(bench):
    session, board = bench.session, "the base's board"
    bench.arm()
    assert session.describe_outcome(True) == (True, f"{board} is armed")
    session.disarm()
    unconfirmed = f"{board} does not confirm that its valves are closed: disarming requested"
    assert session.describe_outcome(False) == (False, f"{unconfirmed}, not confirmed")
    for _ in range(5):
        bench.step()
    assert session.describe_outcome(False) == (True, f"{board} is disarmed")
    session.stop()
    bench.step()
    bench.step()
    assert session.describe_state() == f"{board} is stopped: it is stopped"


def test_the_board_s_health_names_values_that_were_not_reported(bench):
    health = BoardHealth(bench.session, None, signed=False)
    bench.session.slow.clear()
    values = health.values()
    assert values.pop("valves' faults") == "none"
    assert set(values.values()) == {"not reported"}
    bench.session.slow |= {BaseSlow.LEFT: 1500, BaseSlow.SUPPLY: 7000, BaseSlow.TANK: 0}
    values = health.values()
    assert (values["remaining opening time of the valves [s]"], values["tank [kPa]"]) == (1.5, 0)
    assert values["supply [kPa]"] == pytest.approx(700.0)
