"""Excitations out of telemetry: whatever the interleaving, and without what spoils them."""

from dataclasses import replace
from itertools import chain
from random import Random

import numpy as np
import pytest
from calib_drives import excitation, excitations, fly
from calib_rig import START, Sample, feed

from fss_arm_calib.drives.calibrate import Telemetry, calibrate
from fss_arm_calib.drives.problem import Windows, _collect_turning
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.segments.excitations import BLOCK, TOO_LATE, ExcitationFinder, Frame
from fss_arm_calib.segments.settings import ExcitationSettings
from fss_arm_model.description_file import described
from fss_arm_model.units import SECOND

ARM = described("truth")
FAST = 10.0 * 0.1 * ARM.links[0].drive.counts_per_turn / (2.0 * np.pi)  # 0.1 rad/s
PERIOD = SECOND // 5


def link(i, seconds, turning=lambda t: True, boot=1, homings=1):
    """Frames of a link, which turns at some times [s]."""
    return [
        Sample(
            START + t + i * 1_000_000,
            i,
            Frame(float(t // PERIOD), FAST * turning(t / SECOND), 1.0, 2.0, 3.0, boot, homings),
        )
        for t in range(0, round(seconds * SECOND), PERIOD)
    ]


def arm(seconds, turning=lambda t: True, **more):
    return [link(i, seconds, turning if i == 1 else lambda t: False, **more) for i in range(1, 5)]


def in_order(links):
    return sorted(chain(*links))


def find(samples, **settings):
    return feed(ExcitationFinder(ARM, ExcitationSettings(**settings)), samples)


def blocks(found):
    return [(one.start - START) // BLOCK for one in found]


def test_all_frames_are_in_excitations_that_follow_each_other():
    samples = in_order(arm(30.0))
    found = find(samples)
    assert blocks(found) == [*range(8)]
    assert all(one.used for one in found)
    for i in range(1, 5):
        own = [one for one in samples if one.stream == i]
        parts = [one.links[i - 1] for one in found]
        assert [t for part in parts for t in part.stamps] == [one.t for one in own]
        for name in ("position", "velocity", "current", "torque", "torque_age"):
            every = [x for part in parts for x in getattr(part, name)]
            assert every == [getattr(one.value, name) for one in own]
    assert found[-1].boots == found[-1].homings == (1, 1, 1, 1)


def test_any_interleaving_gives_the_same():
    """Each link's frames in order, the links up to a minute apart."""
    links, rng = arm(100.0), Random(1)
    expected = find(in_order(links))
    late = [rng.uniform(0.0, 50.0) * SECOND for _ in links]
    mixed = sorted(chain(*links), key=lambda one: one.t + late[one.stream - 1])
    assert find(mixed) == expected
    one_after_the_other = [sample for those in links for sample in those if sample.t < START + 55e9]
    assert find(one_after_the_other) == find(sorted(one_after_the_other))


def test_what_is_found_live_is_found_at_once_when_the_arm_rests_or_after_a_minute():
    finder, times = ExcitationFinder(ARM), []
    for t, i, frame in in_order(arm(150.0, lambda t: t < 130.0)):
        if found := finder.add_frame(i, t, frame):
            times.append((round((t - START) / SECOND), len(found)))
    assert times == [(60, 15), (120, 15), (136, 4)]


def test_a_block_at_rest_is_none_unless_it_follows_one_that_is_not():
    found = find(in_order(arm(60.0, lambda t: 9.0 < t < 13.0 or 41.0 < t < 42.0)))
    assert blocks(found) == [2, 3, 4, 10, 11]
    creeping = in_order(arm(12.0))
    assert len(find(creeping, min_speed=0.09)) == 3
    assert find(creeping, min_speed=0.11) == []


def test_nothing_is_lost_when_it_is_closed_amid_a_motion():
    """Nor does one that goes on take again what was kept."""
    samples, finder = in_order(arm(30.0)), ExcitationFinder(ARM)
    cut = len(samples) // 2 + 1
    first = feed(finder, samples[:cut])
    for then in (
        feed(finder, samples[cut:]),
        feed(ExcitationFinder(ARM, kept=first), samples),
    ):
        assert then[0].start > first[-1].start
        assert all(one.used for one in [*first, *then])
        parts = [part for one in [*first, *then] for part in one.links]
        assert sum(len(part.stamps) for part in parts) == len(samples)


def test_a_gap_of_a_link_is_named():
    links = arm(20.0)
    links[2] = [one for one in links[2] if not 5.0 < (one.t - START) / SECOND < 6.5]
    found = find(in_order(links))
    assert [one.used for one in found] == [True, False, True, True, True]
    assert found[1].reason == "link_3 silent for 1.80 s"
    assert find(in_order(links), joint_gap=2.0)[1].used


def test_a_link_that_was_homed_meanwhile_is_named_and_what_was_before_is_left_out():
    links = arm(40.0)
    links[1] = [
        one._replace(value=one.value._replace(homings=2)) if one.t > START + 18 * SECOND else one
        for one in links[1]
    ]
    found = find(in_order(links))
    assert [k for k, one in enumerate(found) if not one.used] == [4]
    assert found[4].reason == "link_2 was homed or restarted"
    assert calibrate(found, ARM).used == tuple(found[5:])


def test_frames_that_are_too_late_are_counted():
    links = arm(200.0)
    mixed = sorted(chain(*links), key=lambda one: one.t + 100 * SECOND * (one.stream == 2))
    finder = ExcitationFinder(ARM)
    found = feed(finder, mixed)
    assert finder.links[1].rejected[TOO_LATE] > 0
    ends = [one.end for one in found if one.used]
    assert ends == sorted(ends)
    for i in range(4):
        stamps = [t for one in found for t in one.links[i].stamps]
        assert stamps == sorted(set(stamps))


@pytest.fixture(scope="module")
def flown():
    """A flight of all joints, as it is found."""
    moves = excitation(ARM.n, np.random.default_rng(5))
    return excitations(fly(ARM, moves[: len(moves) // 2], seed=5).telemetry, ARM)


def test_nothing_reaches_across_what_was_left_out(flown):
    """There nobody knows how the arm moved; splines would guess it."""
    out, s = {10, 25, 26}, DrivesSettings()
    some = [one for k, one in enumerate(flown) if k not in out]
    links = [Telemetry.of(some, i).samples(k, flown[0].start) for i, k in enumerate(ARM.links)]
    windows = Windows(ARM, links, s)
    for k in out:
        begin, end = (1e-9 * (t - flown[0].start) for t in (flown[k].start, flown[k].end))
        half = 0.5 * s.window
        assert not np.any((windows.t > begin - half) & (windows.t < end + half))
        for j, link in enumerate(links):
            t = _collect_turning(windows, link, j, s).t
            assert not np.any((t > begin - link.period) & (t < end + link.period))
    seconds = 4.0 * len(some)
    assert len(windows.t) > 0.8 * seconds / (0.5 * half)  # else there is nothing to be wrong


def test_an_estimate_does_without_what_was_left_out(flown):
    whole = calibrate(flown, ARM)
    less = calibrate([replace(one, used=k not in (10, 25, 26)) for k, one in enumerate(flown)], ARM)
    assert less.left_out == 3
    assert np.nanmax(np.abs(less.values - whole.values) / whole.deviations) < 1.0
