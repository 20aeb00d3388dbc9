"""Faults: their kinds, fault scripts, and their effects on datagrams."""

from collections import Counter
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from random import Random

import pytest

from fss_arm_model.units import SECOND
from fss_sim.faults import Event, FaultError, Faults, LinkFaults, fault_classes, read_script
from fss_sim.link.channel import Channel, Datagram

ROOT = Path(__file__).parents[3]


def test_a_script_overrides_faults_set_by_hand_while_it_is_active():
    faults = Faults(
        2,
        read_script(
            """
            - {at: 1.0, part: link_2, fault: loss, value: 0.5, duration: 2.0}
            - {at: 2.0, part: link_2, fault: loss, value: 0.7, duration: 0.5}
            - {at: 2.0, part: end_effector, fault: frozen}
            """
        ),
    )
    faults.set("link_2", "loss", 0.1)
    history = []
    for t in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0):
        changed = faults.advance(t)
        history.append((changed, faults.links[1].loss, faults.tip.frozen))
    assert history == [
        (False, 0.1, 0), (True, 0.5, 0), (False, 0.5, 0), (True, 0.7, 1), (True, 0.5, 1),
        (True, 0.1, 1),
    ]  # fmt: skip
    assert faults.active() == [("link_2", "loss", 0.1), ("end_effector", "frozen", 1.0)]
    assert faults.links[0] == LinkFaults()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{at: 1}", "expected a list"),
        ("- {at: 1, part: link_1}", "expected at, part, fault, value, duration"),
        ("- {at: x, part: link_1, fault: loss}", "could not convert"),
        ("- {at: -1, part: link_1, fault: loss}", "expected 0 or more"),
        ("- {at: 1, part: link_1, fault: loss, duration: 0}", "above 0"),
        ("- {at: 1, part: link_1, fault: loss, until: 3}", "until"),
        ("- [1, 2", "invalid fault script"),
    ],
)
def test_an_invalid_script_is_rejected_in_one_line(text, words):
    with pytest.raises(FaultError, match=words) as error:
        read_script(text)
    assert "\n" not in str(error.value)


def test_an_impossible_fault_is_rejected_before_the_start():
    for event, words in (
        (Event(1.0, "link_3", "loss"), "there is no part 'link_3', expected one of link_1, link_2"),
        (Event(1.0, "link_1", "swap"), "link_1 has no fault 'swap', expected one of loss"),
        (Event(1.0, "fss", "dropout", 1.5), "fss.dropout is 1.5, expected 0 to 1"),
    ):
        with pytest.raises(FaultError, match=words):
            Faults(2, [event])


def send_all(faults, count=2000, period=SECOND // 5):
    """Return time of arrival and data of `count` datagrams, one sent per period."""
    channel, got = Channel(Random(1)), []
    for k in range(count + 100):
        now = k * period
        if k < count:
            channel.send(Datagram(k.to_bytes(4, "big") + bytes(68), None), now, faults)
        got += [(now, d.data) for d in channel.arrived(now)]
    return got


def numbers(got):
    return [int.from_bytes(data[:4], "big") for _, data in got]


def test_without_faults_datagrams_arrive_at_once():
    got = send_all(LinkFaults())
    assert numbers(got) == list(range(2000))
    assert all(t == k * SECOND // 5 for k, (t, _) in enumerate(got))


@pytest.mark.parametrize(("name", "least", "most"), [("loss", 0, 1), ("duplication", 1, 2)])
def test_shares_of_the_datagrams_are_lost_or_duplicated(name, least, most):
    counts = Counter(numbers(send_all(LinkFaults(**{name: 0.3}))))
    share = sum(counts[k] != 1 for k in range(2000)) / 2000
    assert share == pytest.approx(0.3, abs=4 * (0.3 * 0.7 / 2000) ** 0.5)
    assert {counts[k] for k in range(2000)} == {least, most}


def test_delay_and_jitter_bound_the_time_in_transit():
    got = send_all(LinkFaults(delay=0.5, jitter=0.4), period=SECOND // 100)
    in_transit = [t - k * SECOND // 100 for (t, _), k in zip(got, numbers(got), strict=True)]
    assert len(got) == 2000
    assert 0.1 * SECOND <= min(in_transit) <= 0.12 * SECOND
    assert 0.88 * SECOND <= max(in_transit) <= 0.91 * SECOND


def test_a_reordered_datagram_comes_after_the_next():
    order = numbers(send_all(LinkFaults(reordering=0.2)))
    assert sorted(order) == list(range(2000))
    overtaken = sum(b < a for a, b in pairwise(order))
    assert overtaken / 2000 == pytest.approx(0.2 / 1.2, abs=0.04)
    assert max(abs(k - n) for k, n in enumerate(order)) == 1


def test_a_corrupted_datagram_has_one_bit_flipped():
    got = send_all(LinkFaults(corruption=0.3))
    sent = [int.from_bytes(k.to_bytes(4, "big") + bytes(68), "big") for k in range(2000)]
    received = [int.from_bytes(data, "big") for _, data in got]
    bits = Counter((a ^ b).bit_count() for a, b in zip(sent, received, strict=True))
    assert bits.keys() == {0, 1}
    assert bits[1] / 2000 == pytest.approx(0.3, abs=0.042)


def test_the_documentation_names_each_fault_and_no_other():
    page = (ROOT / "docs/explanation/simulator.md").read_text()
    table = page[page.index("| part | fault |") :].split("\n\n")[0]
    documented = [row.split("|")[2].strip(" `") for row in table.splitlines()[2:]]
    assert documented == [
        f.name for kind in dict.fromkeys(fault_classes(2).values()) for f in fields(kind)
    ]


def test_the_example_is_a_script():
    Faults(4, read_script((ROOT / "config/faults.yaml").read_text()))
