"""Rests, maneuvers and drifts out of the same streams: whatever arrives, and however."""

from itertools import pairwise

import numpy as np
import pytest
from calib_float import Float, postures, telemetry
from calib_rig import SUBJECTS, Sample, at, feed, frozen

from fss_arm_calib.segments.drifts import DriftFinder
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_calib.segments.rests import RestFinder
from fss_arm_calib.segments.settings import DriftFinderSettings, ManeuverSettings, RestSettings
from fss_arm_model.units import SECOND

KINDS = {
    "rests": lambda n=4, **s: RestFinder(n, RestSettings(**s)),
    "maneuvers": lambda n=4, **s: ManeuverFinder(n, ManeuverSettings(**s)),
    "drifts": lambda n=4, **s: DriftFinder(
        n, DriftFinderSettings(min_duration=5.0, max_duration=20.0, **s)
    ),
}
STREAMS = [1, 2, 3, 4, "base", "tip", "gyro", "link_2"]
NAMES = {**{i: f"joint_{i}" for i in range(1, 5)}, **SUBJECTS}
STATE = np.array([0.1, 0.2, 3.0, 0.02, -0.01, 0.003, 0.001, -0.0005])
YEAR_2038 = 2**31 * SECOND - 1


@pytest.fixture(params=KINDS)
def make(request):
    """A new finder of each kind."""
    return KINDS[request.param]


@pytest.fixture(scope="module")
def rig():
    return Float(postures(3), state=STATE, rest=8.0)


@pytest.fixture(scope="module")
def samples(rig):
    """Four rests and the maneuvers between them: joints, both subjects, gyro and telemetry."""
    return telemetry(rig.samples(rate=20, tip=True))


def by_stream(samples):
    streams: dict[int | str, list[Sample]] = {}
    for s in samples:
        streams.setdefault(s.stream, []).append(s)
    return streams


def interleaved(samples, seed, most=300):
    """In another order that keeps each stream's own."""
    rng, streams, mixed = np.random.default_rng(seed), by_stream(samples), []
    while streams:
        name = sorted(streams, key=str)[rng.integers(len(streams))]
        burst = int(rng.integers(1, most))
        mixed += streams[name][:burst]
        streams[name] = streams[name][burst:]
        if not streams[name]:
            del streams[name]
    return mixed


def total(rejected, *reasons):
    return sum(number for kind, number in rejected.items() if kind.endswith(reasons))


def test_all_are_found_in_order_of_time(make, samples):
    found = feed(make(), samples)
    assert len(found) == (3 if isinstance(make(), ManeuverFinder) else 4)
    assert all(getattr(one, "used", True) for one in found)
    assert all(a.start < b.start for a, b in pairwise(found))
    for lost in ("base", 2):
        nothing = feed(make(), [s for s in samples if s.stream != lost])
        assert not any(getattr(one, "used", True) for one in nothing)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 12))]
)
def test_the_order_of_arrival_does_not_matter(make, samples, seed):
    """Gaps, occlusions, frozen poses, jumps and stamps astray included."""
    rng = np.random.default_rng(seed)
    worse = [s for s in samples if s.stream != 2 or not at(30.0) < s.t < at(31.2)]
    for k in rng.choice(len(worse), 40, replace=False):
        s = worse[k]
        ill = [
            s._replace(t=YEAR_2038),
            s._replace(t=s.t - 400 * SECOND),
            s._replace(t=s.t - SECOND),
        ]
        if s.stream in SUBJECTS:
            x, y, heading = s.value
            ill += [s._replace(value=None), s._replace(value=(x + 2.0, y, heading))]
        worse[k] = ill[rng.integers(len(ill))]
    expected = feed(make(), worse)
    assert len(expected) >= 3
    for order in range(3):
        assert feed(make(), interleaved(worse, order)) == expected


def test_poses_and_rates_may_come_in_bursts(make, samples):
    """Occluded, frozen, impossible and those that jump included."""
    worse = []
    for k, s in enumerate(frozen(samples, "base", 20.0, 21.7)):
        worse.append(s)
        if k % 97 == 0 and s.stream in SUBJECTS:
            ill = None, (1e308, *s.value[1:]), (s.value[0] + 2.0, *s.value[1:])
            worse.append(s._replace(t=s.t + 1, value=ill[k % 3]))
        elif k % 97 == 0 and s.stream == "gyro":
            worse.append(s._replace(t=[s.t + 1, YEAR_2038][k % 2], value=[np.nan, s.value][k % 2]))
    one_by_one, together, found = make(), make(), []
    for name, stream in by_stream(worse).items():
        if name not in (*SUBJECTS, "gyro"):
            found += feed(together, stream, close=False)
            continue
        for k in range(0, len(stream), 7):
            t = np.array([s.t for s in stream[k : k + 7]], dtype=np.int64)
            values = [s.value or 3 * (np.nan,) for s in stream[k : k + 7]]
            if name == "gyro":
                found += together.add_rates(t, np.array(values, dtype=float))
            else:
                found += together.add_poses(SUBJECTS[name], t, np.array(values))
    assert found + together.close() == feed(one_by_one, worse)
    assert together.streams() == one_by_one.streams()


@pytest.mark.parametrize(("stamp", "place"), [(YEAR_2038, "first"), (0, "amid")])
def test_a_stamp_far_from_all_others_is_rejected_by_itself(make, samples, stamp, place):
    """Three on end, in any one stream or in all at once: one stopped a calibration for good."""
    expected, streams = feed(make(), samples), by_stream(samples)
    for those in (["base"], STREAMS):
        astray = [streams[name][0]._replace(t=stamp + k) for name in those for k in range(3)]
        k = 0 if place == "first" else len(samples) // 2
        finder = make()
        assert feed(finder, [*samples[:k], *astray, *samples[k:]]) == expected, those
        assert finder.streams().rejected == {
            f"{NAMES.get(name, name)} isolated in time": 3 for name in sorted(those, key=str)
        }
        assert not any(finder.streams().set_back.values())


def test_a_clock_that_all_share_may_be_set_ahead(make, rig, samples):
    """By a day amid the third rest: what came before is found, and what comes after."""
    moment = at(0.5 * (rig.ends[1] + rig.begins[2]))
    step = 86_400 * SECOND
    finder, whole = make(), feed(make(), samples)
    found = feed(finder, [s if s.t < moment else s._replace(t=s.t + step) for s in samples])
    assert not finder.streams().rejected
    assert found[0] == whole[0]
    assert found[-1].end == whole[-1].end + step


def test_a_clock_set_back_is_told_and_a_new_finder_begins_anew(make, rig, samples):
    moment = at(0.5 * (rig.ends[1] + rig.begins[2]))
    late = [s._replace(t=s.t - 5 * SECOND) for s in samples if s.t >= moment]
    finder = make()
    feed(finder, [s for s in samples if s.t < moment] + late)
    backs = finder.streams().set_back
    assert [backs[name] for name in NAMES.values()] == pytest.approx([5] * 6, abs=0.5)
    again = make()
    assert feed(again, late) == feed(make(), late)
    assert not any(again.streams().set_back.values())


@pytest.mark.parametrize("value", [np.nan, 1e308])
def test_numbers_that_no_sensor_reads_and_repeats_are_rejected_and_counted(make, samples, value):
    """From the very first sample on, each with a stamp of its own; repeats of each joint's."""
    bad, poses = [], 0
    for k, s in enumerate(samples):
        part = k % 3
        if s.stream in SUBJECTS and k % 10 == 0:
            pose = [*s.value[:part], value, *s.value[part + 1 :]]
            bad.append(s._replace(t=s.t - 1, value=tuple(pose)))
            poses += 1
        elif s.stream == "gyro" and k % 10 == 0:
            bad.append(s._replace(t=s.t - 1, value=value))
        elif isinstance(s.stream, int):
            bad.append(s._replace(t=s.t - 1, value=(value, 0.0)))
        bad += [s, s]
    finder = make()
    assert feed(finder, bad) == feed(make(), samples)
    rejected, numbers = finder.streams().rejected, len(bad) - 2 * len(samples)
    assert total(rejected, "repeated") == len(samples)
    assert total(rejected, "occluded", "not finite", "out of range") == numbers
    assert sum(rejected.values()) == numbers + len(samples)
    assert total(rejected, "occluded") in (0, poses)


@pytest.mark.parametrize(
    ("rate", "rejected"), [(np.nan, set()), (1e308, {"joint_3 rate out of range"})]
)
def test_a_rate_that_no_link_reports_or_no_drive_has_is_derived(samples, rate, rejected):
    """Of its reading nothing is wrong."""
    bad = [
        s._replace(value=(s.value[0], rate)) if s.stream == 3 and s.t % SECOND < 3e8 else s
        for s in samples
    ]
    finder = ManeuverFinder(4)
    found, expected = feed(finder, bad), feed(ManeuverFinder(4), samples)
    assert [m.q for m in found] == [m.q for m in expected]
    for one, other in zip(found, expected, strict=True):
        assert one.qd[2] == pytest.approx(other.qd[2], abs=0.12)
    assert finder.streams().rejected.keys() == rejected


def test_memory_is_bounded(make, rig, samples):
    """Three times the same: all streams, without a joint, and with the arm silent."""
    finder = make(horizon=10.0)
    for lap, silent in enumerate(((), (2,), (1, 2, 3, 4))):
        shift = lap * round((rig.length + 1.0) * SECOND)
        heard = [s for s in samples if s.t < at(rig.length - 1.0) and s.stream not in silent]
        feed(finder, [s._replace(t=s.t + shift) for s in heard], close=False)
        kept = 2 * 10.0 + finder.sensors.settings.max_duration + 22.0
        for poses in (finder.sensors.base, finder.sensors.tip, finder.sensors.gyro):
            assert len(poses.t) < 20 * kept + 1000
        assert len(finder.sensors.joints[0].t) < 5 * kept + 1000 / 8
        assert max(len(joint.queue) for joint in finder.sensors.joints) <= 51
        assert len(finder.pending) <= 3


@pytest.mark.parametrize("begin", [4.0, 9.0])
def test_what_a_frozen_base_hides_is_rejected(make, rig, samples, begin):
    """Since amid the first rest or the first motion, until amid the second motion."""
    end = rig.begins[1] + 1.0
    finder, whole = make(), feed(make(), samples)
    found = feed(finder, frozen(samples, "base", begin, end))
    hidden = [one for one in whole if one.end > at(begin) and one.start < at(end)]
    used = [one for one in found if getattr(one, "used", True)]
    assert 0 < len(used) < len(whole)
    assert {one.start for one in used} >= {one.start for one in whole if one not in hidden}
    reasons = [one.reason for one in found if not getattr(one, "used", True)]
    assert all(reason.startswith("fss frozen for") for reason in reasons)
    assert finder.streams().rejected["fss frozen"] > 50


@pytest.mark.parametrize("make", ["rests", "maneuvers"], indirect=True)
def test_a_base_that_stands_still_without_noise_is_not_frozen(make, rig, samples):
    """A simulated one has the very same pose in each frame, once the arm rests."""
    expected, finder = feed(make(), samples), make()
    for begin, end in zip([0.01, *rig.ends], [*rig.begins, rig.length], strict=True):
        samples = frozen(samples, "base", begin, end)
    found = feed(finder, samples)
    assert len(found) == len(expected)
    assert all(getattr(one, "used", True) for one in found)
    assert "fss frozen" not in finder.streams().rejected


def test_a_lost_base_is_waited_for_no_longer_than_the_horizon(make, rig, samples):
    """Name the base, not a joint, before its poses return."""
    finder, lost = make(horizon=15.0), at(rig.ends[0] + 7.5)
    found = feed(finder, [s for s in samples if s.stream != "base" or s.t < lost], close=False)
    told = [one for one in found if not getattr(one, "used", True)]
    used, unused = (1, 1) if isinstance(finder, ManeuverFinder) else (2, 0)
    assert (len(found) - len(told), len(told)) == (used, unused)
    assert all(one.reason.startswith("fss silent for") for one in told)
