"""Shared radio channel: airtime, delay under load, bursts of loss, retries."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_link.protocol import FRAME_SIZE
from fss_sim import testbed
from fss_sim.faults import Event, LinkFaults
from fss_sim.link.channel import Channel, Datagram
from fss_sim.link.radio import HEADERS, Radio, RadioChannel
from fss_sim.noise import PRESETS
from fss_sim.testbed import State

CLEAN = Radio(loss=0.0, burst_interval=0.0)
START = State(frame=0, boots=1, rests=0, q=(0.0,) * 7, qd=(0.0,) * 7)


def delays(radio, rate, stations=5, seconds=60, interference=0.0, seed="1"):
    """Return the delays of datagrams sent at random times, `rate` per second [s]; nan: lost."""
    channel, random = RadioChannel(radio, seed), Random(f"{seed}, times")
    channel.interference = interference
    senders, now, delays_ = [channel.station(str(i)) for i in range(stations)], 0, []
    while now < seconds * SECOND:
        now += round(SECOND * random.expovariate(rate))
        arrival = senders[random.randrange(stations)].transmit(FRAME_SIZE, now)
        delays_.append(np.nan if arrival is None else (arrival - now) / SECOND)
    return np.array(delays_)


def test_an_undisturbed_datagram_takes_its_airtime_and_some_slots():
    channel = RadioChannel(replace(CLEAN, rate=1e6, overhead=0.001), "1")
    assert channel.airtime(FRAME_SIZE) == 1_000_000 + 8_000 * (FRAME_SIZE + HEADERS)
    station = channel.station("1")
    delays_ = [station.transmit(FRAME_SIZE, k * SECOND) - k * SECOND for k in range(500)]
    assert min(delays_) == channel.airtime(FRAME_SIZE)
    assert max(delays_) == channel.airtime(FRAME_SIZE) + 31 * 20_000  # the slots of a first attempt


def test_latency_grows_with_the_load():
    airtime = RadioChannel(CLEAN, "1").airtime(FRAME_SIZE) / SECOND
    medians = [np.nanmedian(delays(CLEAN, load / airtime)) for load in (0.01, 0.3, 0.6)]
    worst = [np.nanmax(delays(CLEAN, load / airtime)) for load in (0.01, 0.3, 0.6)]
    assert medians[0] < medians[1] < medians[2]
    assert worst[0] < worst[1] < worst[2]
    assert medians[0] == pytest.approx(airtime, rel=0.35)
    flood = delays(CLEAN, 3.0 / airtime, seconds=20)
    assert np.isnan(flood).mean() > 0.5  # more than the channel can carry
    assert np.nanmax(flood) <= CLEAN.patience + airtime


def test_interference_delays_datagrams():
    shares = (0.0, 0.5, 0.8)
    free, half, most = (
        np.nanmean(delays(CLEAN, 2.0, seconds=2000, interference=t)) for t in shares
    )
    # Before each attempt, another station sends with this probability, repeatedly. 4000 draws.
    foreign = RadioChannel(CLEAN, "1").airtime(1500) / SECOND
    assert half - free == pytest.approx(0.5 / 0.5 * foreign, rel=0.1)
    assert most - free == pytest.approx(0.8 / 0.2 * foreign, rel=0.15)


def test_retries_lose_what_fails_each_time_and_cost_time():
    for retries in (0, 1, 3):
        delays_ = delays(replace(CLEAN, loss=0.5, retries=retries), 20.0, seconds=200)
        lost = np.isnan(delays_).mean()
        assert lost == pytest.approx(0.5 ** (retries + 1), abs=4 * (0.25 / len(delays_)) ** 0.5)
    assert np.nanmean(delays_) > 1.5 * np.nanmean(delays(CLEAN, 20.0))


def test_each_station_has_bursts_of_loss_of_the_stated_length_and_share():
    radio = Radio(loss=0.0, burst_interval=5.0, burst_length=0.5, burst_loss=1.0, retries=0)
    channel = RadioChannel(radio, "3")
    one, other = channel.station("1"), channel.station("2")
    times = range(0, 2000 * SECOND, SECOND // 20)
    lost = np.array([[s.loss(t) for s in (one, other)] for t in times]) > 0.5
    shares = lost.mean(axis=0)
    np.testing.assert_allclose(shares, 0.5 / 5.5, rtol=0.25)  # of some 360 bursts
    assert (lost[:, 0] & lost[:, 1]).mean() < 0.3 * shares.mean()  # each has its own
    same = [RadioChannel(radio, "1").station(f"{vehicle} 1") for vehicle in "ab"]
    assert any(same[0].loss(t) != same[1].loss(t) for t in range(0, 60 * SECOND, SECOND))
    edges = np.flatnonzero(np.diff(lost[:, 0].astype(int)))
    runs = np.diff(edges)[0 if lost[edges[0] + 1, 0] else 1 :: 2] / 20
    assert runs.mean() == pytest.approx(0.5, rel=0.25)


def test_faults_add_to_the_delay_of_the_channel():
    radio_channel = RadioChannel(CLEAN, "1")
    channel = Channel(Random(1), radio_channel.station("1"))
    channel.send(Datagram(bytes(72), None), 0, LinkFaults(delay=0.1))
    at = radio_channel.airtime(72)
    assert not channel.arrived(SECOND // 10 + at - 1)
    assert channel.arrived(SECOND // 10 + at + 32 * 20_000)
    channel.send(Datagram(bytes(72), None), SECOND, LinkFaults(loss=1.0))
    assert not channel.arrived(9 * SECOND)


def telemetry(seconds, script=(), radio=CLEAN, rate=20.0):
    """Return the frames that arrive from each link of a bed with a board, and the bed."""
    bed = testbed.Testbed(
        paper_arm(),
        PRESETS["ideal"],
        1,
        START,
        rate,
        script=script,
        board_rate=20.0,
        radio_channel=RadioChannel(radio, "1, 1"),
    )
    reports = [bed.step() for _ in range(100 * seconds)]
    return [[d.data for r in reports for d in r.telemetry[i]] for i in range(4)], bed


def test_a_bed_with_radio_delivers_all_frames_reproducibly_unless_crowded():
    frames, bed = telemetry(5)
    assert all(98 <= len(of_link) <= 101 for of_link in frames)
    assert bed.radio_channel.utilization(bed.now) == pytest.approx(
        100 * bed.radio_channel.airtime(72) / SECOND, rel=0.05
    )
    assert bed.radio_channel.utilization(bed.now + 2 * SECOND) == 0.0
    assert telemetry(5)[0] == frames
    crowded, _ = telemetry(5, [Event(0.0, "radio", "interference", 0.95)])
    assert sum(map(len, crowded)) < 0.9 * sum(map(len, frames))
    bursts, _ = telemetry(5, radio=Radio(burst_interval=1.0, burst_length=1.0, burst_loss=1.0))
    assert 0.2 * 400 < sum(map(len, bursts)) < 0.8 * 400
