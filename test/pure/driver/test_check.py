"""The first day with hardware, on links that are right and on links that are not."""

import sys
from dataclasses import replace
from math import pi

import pytest

from fss_arm_driver import check, trials
from fss_arm_driver.protocol import Mode
from fss_arm_driver.trials import FAIL, NOT_TRIED, PASS, Rig
from fss_arm_model.description import Drive, TorqueSensor, paper_arm
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.vehicle import Motion

LINK = paper_arm().links[0]
INERTIA = 0.3  # [kg m^2]
STEP = 0.005  # [s]


class Bench:
    """A link on a bench and its person, in time of their own; also replaces the module `time`."""

    def __init__(self, description, friction=0.0, deaf=False, hand=pi / 2, load=0.5, number=1):
        self.counts, self.problem = {}, ""
        self.link = LinkElectronics(number, description, boot=3)
        self.modes = [Mode.OFF]  # that the drive was in, without repetition
        self.seconds, self.q, self.qd, self.torque, self.current = 0.0, -0.6, 0.0, 0.0, 0.0
        self.friction, self.deaf, self.hand, self.load = friction, deaf, hand, load
        self.frames, self.asked = [], []

    def monotonic(self):
        return self.seconds

    def monotonic_ns(self):
        return round(self.seconds * 1e9)

    def time_ns(self):
        return 1_700_000_000_000_000_000 + round(self.seconds * 1e9)

    def clock(self):
        return 10_000_000 + round(self.seconds * 1e6)

    def send(self, data):
        if not self.deaf:
            self.link.receive(data, self.clock())

    def wait(self, timeout):
        for _ in range(max(1, round(timeout / STEP))):
            self.step()
        return bool(self.frames)

    def step(self):
        motion = Motion(self.q, self.qd, self.current, self.torque)
        demand = self.link.demand(self.clock(), motion)
        self.current = demand.set_point if demand.mode == Mode.CURRENT else 0.0
        push = 0.8 * self.current
        if demand.mode != self.modes[-1]:
            self.modes.append(demand.mode)
        if demand.mode == Mode.CURRENT:
            self.torque = push
            free = max(0.0, abs(push) - self.friction)
            self.qd += STEP * free / INERTIA * (1 if push > 0 else -1)
        elif demand.mode == Mode.VELOCITY:
            self.qd = demand.set_point if self.friction < 1.0 else 0.0
        else:
            self.qd, self.torque = 0.0, self.torque if demand.mode == Mode.OFF else 0.0
        self.q += STEP * self.qd
        self.seconds += STEP
        if data := self.link.telemetry(
            self.clock(), Motion(self.q, self.qd, self.current, self.torque)
        ):
            self.frames.append(data)

    def receive(self):
        frames, self.frames = self.frames, []
        return frames

    def close(self):
        pass

    def ask(self, question):
        """An operator who follows the instructions and answers."""
        self.asked.append(question)
        if "Turn the joint by hand" in question:
            self.q += self.hand
            return "90"
        if "known torque" in question:
            self.torque = self.load
            return "0.5"
        self.torque = 0.0
        return "yes"


def at_each_step(bench, act):
    """Have `act()` done before each step of a bench; return what a step was before."""
    step = bench.step

    def both():
        act()
        step()

    bench.step = both
    return step


@pytest.fixture
def tried(monkeypatch):
    """tried(bench): the findings on a bench by name, with the paper's link as description."""

    def run(bench, ask=None):
        monkeypatch.setattr(trials, "time", bench)
        rig = Rig(1, LINK, bench, None)
        assert rig.listen(3.0)
        return {f.name: f for f in trials.trials(rig, ask or bench.ask, 0.1)}

    return run


def test_a_supply_that_was_not_reported_yet_is_not_0_volts(monkeypatch):
    monkeypatch.setattr(trials, "time", bench := Bench(LINK))
    rig = Rig(1, LINK, bench, None)
    assert rig.listen(3.0)
    assert ", supply 24.0 V, " in trials.answers(rig).found
    monkeypatch.setattr(rig, "wait_until", lambda *_: False)
    rig.session.slow.clear()
    assert ", supply not reported yet, " in trials.answers(rig).found


def test_a_link_that_is_as_described_passes(tried):
    bench = Bench(LINK)
    found = tried(bench)
    assert list(found) == [
        "answers",
        "direction and counts per turn",
        "torque zero",
        "torque gain",
        "current sign",
        "measured current",
        "torque sign",
        "stop",
        "watchdog",
    ]
    assert {f.verdict for f in found.values()} == {PASS}
    assert "firmware 2.1.0" in found["answers"].found
    assert found["direction and counts per turn"].found.startswith("240000 counts a turn")
    assert "watchdog 1.0 s" in found["watchdog"].found
    assert not bench.link.armed
    assert bench.modes[-1] == Mode.OFF


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"drive": Drive(direction=-1)}, "direction and counts per turn", "-240000 counts a turn"),
        ({"drive": Drive(counts_per_turn=200_000)}, "direction and counts per turn", "200000"),
        ({"torque_sensor": TorqueSensor(zero=1e6)}, "torque zero", "off by +0.2503 N m"),
        ({"torque_sensor": TorqueSensor(gain=-2.1 / 2**23)}, "torque gain", "-2.5034e-07 N m"),
        ({"torque_sensor": TorqueSensor(gain=-2.1 / 2**23)}, "torque sign", "N m while"),
    ],
)
def test_what_is_not_as_described_fails_with_what_was_found(tried, changes, name, words):
    found = tried(Bench(replace(LINK, **changes)))
    assert found[name].verdict == FAIL
    assert words in found[name].found


def test_a_joint_that_sticks_is_said(tried):
    bench = Bench(LINK, friction=10.0)
    found = tried(bench)
    assert found["current sign"].verdict == FAIL
    assert found["current sign"].found == "does not turn with up to -0.50 A"
    assert bench.modes[-1] == Mode.OFF


def test_a_motor_that_turns_the_other_way_is_found_and_gets_no_velocity(tried):
    bench = Bench(LINK)
    step = bench.step

    def other_way():
        before = bench.q
        step()
        if bench.current:
            bench.q = 2 * before - bench.q

    bench.step = other_way
    found = tried(bench)
    assert found["current sign"].verdict == FAIL
    assert "-0.10 A turned it by +" in found["current sign"].found
    assert {found[name].verdict for name in ("stop", "watchdog")} == {NOT_TRIED}
    assert found["stop"].found == "the current sign has not passed"
    assert Mode.VELOCITY not in bench.modes


def test_a_joint_that_comes_to_stick_is_released(tried):
    bench = Bench(LINK)

    def stick():
        if bench.modes[-1] == Mode.VELOCITY:
            bench.friction = 10.0

    at_each_step(bench, stick)
    found = tried(bench)
    assert found["complete"].verdict == FAIL
    assert found["complete"].found == "does not turn at a slow velocity"
    assert bench.modes[-2:] == [Mode.VELOCITY, Mode.OFF]


@pytest.mark.parametrize("mode", [Mode.CURRENT, Mode.VELOCITY])
def test_an_interrupted_trial_releases_the_joint(tried, mode):
    bench = Bench(LINK)

    def interrupt():
        if bench.modes[-1] == mode and abs(bench.qd) > 0.01:
            bench.step = step
            raise KeyboardInterrupt

    step = at_each_step(bench, interrupt)
    with pytest.raises(KeyboardInterrupt):
        tried(bench)
    assert bench.modes[-1] == Mode.OFF


def test_a_drive_that_is_not_seen_to_switch_off_fails(tried):
    bench = Bench(LINK)

    def fall_deaf():
        bench.deaf = bench.deaf or bench.link.watchdog_tripped

    at_each_step(bench, fall_deaf)
    found = tried(bench)
    assert found["complete"].verdict == FAIL
    assert found["complete"].found == "link 1 does not confirm that it is off: cut its power"


def test_a_torque_sensor_that_is_not_there_does_not_pass(tried):
    bench = Bench(LINK)
    bench.link.instruments.torque.age = lambda _: 255_000
    found = tried(bench)
    assert {f.name: f.verdict for f in found.values() if "torque" in f.name} == {
        "torque zero": FAIL,
        "torque gain": NOT_TRIED,
        "torque sign": NOT_TRIED,
    }
    assert found["torque zero"].found == "no samples of the torque sensor are received"
    assert not any("known torque" in question for question in bench.asked)


def test_a_torque_sensor_may_fail_under_load_and_a_person_take_their_time(tried):
    bench = Bench(LINK)

    def ask(question):
        for _ in range(round(20.0 / STEP)):
            bench.step()
        if "known torque" in question:
            bench.link.instruments.torque.age = lambda _: 255_000
        return bench.ask(question)

    failed = {name for name, f in tried(bench, ask).items() if f.verdict != PASS}
    assert failed == {"torque gain", "torque sign"}


def test_nothing_moves_unless_a_person_agrees(tried):
    bench = Bench(LINK, hand=0.0)
    found = tried(bench, ask=lambda _: "")
    assert {f.name for f in found.values() if f.verdict == NOT_TRIED} == {
        "direction and counts per turn",
        "torque gain",
        "current sign",
        "stop",
        "watchdog",
    }
    assert bench.q == -0.6


@pytest.fixture
def checked(monkeypatch, tmp_path):
    """checked(benches by URL, ask(bench, question)): the exit code, and what was written."""

    def run(benches, ask=Bench.ask):
        def open_transport(url, *_):
            bench = benches[url]
            if isinstance(bench, Exception):
                raise bench
            monkeypatch.setattr(trials, "time", bench)
            monkeypatch.setattr("builtins.input", lambda question: ask(bench, question))
            return bench

        output = tmp_path / "check.yaml"
        monkeypatch.setattr(check, "open_transport", open_transport)
        monkeypatch.setattr("sys.argv", ["check", *benches, "--output", str(output)])
        code = check.main()
        return code, output.read_text()

    return run


FIRST_URL, SECOND_URL = "udp://first:5001", "udp://second:5001"


def test_the_result_is_written_and_the_exit_code_tells(checked, capsys):
    code, text = checked({FIRST_URL: Bench(LINK)})
    assert code == 0
    assert '    url: "udp://first:5001"\n' in text
    assert text.count('verdict: "pass"') == 9
    assert "link 1: watchdog: pass: at rest" in capsys.readouterr().out


def test_a_place_where_nothing_answers_is_a_failure(checked, capsys):
    bench = Bench(LINK, deaf=True)
    bench.receive = list
    assert checked({FIRST_URL: bench})[0] == 2
    assert "udp://first:5001: no link answers: is it switched on?" in capsys.readouterr().out


@pytest.mark.parametrize("when", ["by hand", "free of any torque", "known torque", "type yes"])
def test_a_link_that_is_lost_fails_and_the_next_is_tried(checked, when):
    def ask(bench, question):
        if bench.link.gate.number == 1 and when in question:
            bench.receive = list
        bench.seconds += 2.0
        return bench.ask(question)

    code, text = checked({FIRST_URL: Bench(LINK), SECOND_URL: Bench(LINK, number=2)}, ask)
    first, second = text.split("  - link: 2")
    assert code == 2
    assert 'verdict: "fail"\n        found: "link 1 is lost' in first
    assert second.count('verdict: "pass"') == 9


@pytest.mark.parametrize(  # without and with a failure before
    ("end", "words", "hand", "code"),
    [(EOFError, "end of input", pi / 2, 3), (KeyboardInterrupt, "interrupted", pi / 4, 2)],
)
def test_what_was_found_before_an_end_is_written(checked, capsys, end, words, hand, code):
    def ask(bench, question):
        if "known torque" in question:
            raise end
        return bench.ask(question)

    got, text = checked({FIRST_URL: Bench(LINK, hand=hand), SECOND_URL: Bench(LINK, number=2)}, ask)
    assert got == code
    assert text.count("verdict") == 4
    assert f'name: "complete"\n        verdict: "not tried"\n        found: "{words}"' in text
    assert capsys.readouterr().err == f"check: {words}\n"


def test_what_was_found_before_a_wrong_url_is_written(checked, capsys):
    code, text = checked({FIRST_URL: Bench(LINK), SECOND_URL: ValueError("no such URL")})
    assert code == 1
    assert text.count('verdict: "pass"') == 9
    assert capsys.readouterr().err == "check: no such URL\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["udp://x"], "expected udp://HOST:PORT"),
        (["udp://127.0.0.1:9", "--arm", "/no/such"], "/no/such"),
        (["udp://127.0.0.1:9", "--current", "2"], "--current is 2.0 A, expected above 0 to 0.4"),
        (["--nonsense"], "URL"),
    ],
)
def test_what_cannot_be_carried_out_is_one_line(monkeypatch, capsys, arguments, words):
    monkeypatch.setattr("sys.argv", ["check", *arguments])
    with pytest.raises(SystemExit) as end:
        sys.exit(check.main())
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
