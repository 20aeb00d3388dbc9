"""VICON's markers: visibility, pose errors, lost and swapped subjects."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_sim import testbed
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.vehicle import Vehicle, World
from fss_sim.sensors import RATE, Sensors, compose
from fss_sim.testbed import FRAME, State
from fss_sim.vicon import BASE, TARGET, TIP, Room, RoomError, Vicon

POSES = [(0.2, -0.1, 0.4), (1.1, 0.3, -0.7), (-1.0, 1.0, 2.0)]
KINDS = [BASE, TIP, TARGET]
RESTING = np.zeros(4)


def cameras(room=None, seed=1, **noise):
    return Vicon(Noise(**noise), room or Room(), seed, KINDS)


@pytest.mark.parametrize("kind", [BASE, TIP])
def test_noise_decreases_with_number_of_markers_and_subject_size(kind):
    vicon, sigma, room = cameras(marker_noise=0.0005), 0.0005, Room()
    errors = np.array([vicon.take_picture(k, POSES)[kind].error for k in range(4000)])
    body = room.markers(kind)[:, :2] @ [1, 1j]
    apart, N = body - body.mean(), len(body)
    r = np.sqrt(np.mean(abs(apart) ** 2))
    middle = errors[:, 0] + 1j * errors[:, 1]
    middle += 1j * errors[:, 2] * np.exp(1j * POSES[kind][2]) * body.mean()  # at the centroid
    # 4000 draws know a deviation to 1.1%, 1 sigma.
    assert np.std(middle.real) == pytest.approx(sigma / math.sqrt(N), rel=0.045)
    assert np.std(middle.imag) == pytest.approx(sigma / math.sqrt(N), rel=0.045)
    assert np.std(errors[:, 2]) == pytest.approx(sigma / (r * math.sqrt(N)), rel=0.045)


def test_the_distortion_grows_to_the_edge_and_is_constant():
    def off(x, y=0.0, seed=1):
        results = cameras(vicon_edge_error=0.002, seed=seed).take_picture(
            0, [(x, y, 0.0), *POSES[1:]]
        )
        return np.array(results[BASE].error)

    middle, half, edge = (np.hypot(*off(x)[:2]) for x in (0.05, 1.0, 2.0))
    assert middle < 1e-5
    assert half == pytest.approx(0.002 / 8, rel=0.1)  # the markers lie around 1 m
    assert edge == pytest.approx(0.002, rel=0.03)
    np.testing.assert_array_equal(off(1.5, -1.0), off(1.5, -1.0))
    assert np.abs(off(1.5) - off(1.5, seed=2)).max() > 1e-5


ONE = Room(cameras=(3.0, 0.0, 3.0, 3.0, 0.1, 3.0))  # both on one side


def bodies(x, y, radius, height, length=0.0):
    """Return the row of a body that is `length` long across the line of sight."""
    half = 0.5 * length
    return [[x, y - half, x, y + half, radius, height]]


def test_a_body_between_a_subject_and_its_cameras_hides_it():
    vicon = cameras(ONE, vicon_occlusion=1.0)
    poses = [(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.5, 0.0)]
    # From x = -1, 0.33 m up, sight rises by 2.67 m in 4 m: at x = -0.8 it is 0.46 m up.
    tall, low, beside = (-0.7, 0.0, 0.15, 0.6), (-0.7, 0.0, 0.15, 0.4), (-0.7, 0.5, 0.15, 0.6)
    link, link_beside = (-0.75, 0.1, 0.06, 0.6, 0.6), (-0.75, -0.6, 0.06, 0.6, 0.6)
    for obstacle, seen in (
        (tall, False), (low, True), (beside, True), (link, False), (link_beside, True),
    ):  # fmt: skip
        base, tip, target = vicon.take_picture(0, poses, bodies(*obstacle))
        assert (base.visible, tip.visible, target.visible) == (True, seen, True), obstacle
    # With cameras all around, it is seen from the other side.
    assert cameras(vicon_occlusion=1.0).take_picture(0, poses, bodies(*tall))[TIP].visible
    assert cameras(ONE).take_picture(0, poses, bodies(*tall))[TIP].visible  # without occlusion


def test_with_fewer_visible_markers_the_pose_is_worse():
    room = replace(ONE, tip_markers=(-0.3, 0.0, 0.0, 0.1, 0.3, 0.0, 0.0, -0.1))
    vicon = cameras(room, vicon_occlusion=1.0, marker_noise=0.001)
    poses = [(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.5, 0.0)]
    hides = bodies(-0.9, 0.0, 0.05, 0.6)  # hides only the rearmost marker
    partial = [vicon.take_picture(k, poses, hides)[TIP] for k in range(500)]
    assert {result.markers for result in partial} == {3}
    whole = [vicon.take_picture(k, poses)[TIP] for k in range(500)]
    few, all_ = (np.std([result.error for result in each], axis=0)[2] for each in (partial, whole))
    assert few > 1.2 * all_


def tip_and_target(distance):
    """Return tip and target, each with one marker, that are `distance` apart."""
    room = Room(
        tip_markers=(0.0, 0.0, -0.1, 0.05, -0.1, -0.05),
        target_markers=(0.0, 0.0, 0.1, 0.08, 0.1, -0.06, 0.2, 0.0),
    )
    return room, [(-1.5, 0.0, 0.0), (0.0, 0.0, 0.0), (distance, 0.0, 0.0)]


def test_markers_that_are_too_close_are_lost_to_both_subjects():
    room, poses = tip_and_target(0.02)
    base, tip, target = cameras(room, vicon_merge_distance=0.03).take_picture(0, poses)
    assert (base.markers, tip.markers, target.markers) == (5, 2, 3)
    assert (tip.visible, target.visible) == (False, True)
    apart = cameras(room, vicon_merge_distance=0.03).take_picture(0, tip_and_target(0.04)[1])
    assert [result.markers for result in apart] == [5, 3, 4]


def test_a_merge_swaps_its_subjects_or_does_not_until_it_ends():
    room, poses = tip_and_target(0.02)
    swapped = 0
    for seed in range(200):
        vicon = cameras(room, seed=seed, vicon_merge_distance=0.03, vicon_merge_swap=0.3)
        during = {
            tuple(result.identified_as for result in vicon.take_picture(k, poses)) for k in range(5)
        }
        assert len(during) == 1  # drawn once per merge
        assert during <= {(0, 1, 2), (0, 2, 1)}
        swapped += during == {(0, 2, 1)}
        after = vicon.take_picture(5, tip_and_target(0.2)[1])
        assert [result.identified_as for result in after] == KINDS
    assert swapped / 200 == pytest.approx(0.3, abs=4 * math.sqrt(0.21 / 200))


def observed(noise, frames, target=None, **room):
    base, tip = (0.1, 0.2, 0.3), (1.0, 0.5, 0.2)
    poses = [base, compose(base, tip), *([target] if target else [])]
    sensors, vicon = Sensors(noise, 1), Vicon(noise, Room(**room), 1, KINDS[: len(poses)])
    return [
        sensors.observe(
            k,
            base,
            tip,
            0.0,
            RESTING,
            target=target,
            marker_results=dict(enumerate(vicon.take_picture(k, poses))),
        )
        for k in range(frames)
    ], poses[TIP]


def test_the_sensors_report_the_results_of_the_cameras():
    (readings,), tip = observed(Noise(vicon_edge_error=1e-9), 1, (-1.0, 0.0, 0.0))
    np.testing.assert_allclose(readings.tip.pose, tip, atol=1e-8)
    room, _ = tip_and_target(0.0)
    merging = Noise(vicon_merge_distance=0.03, vicon_merge_swap=1.0)
    places = {"tip_markers": room.tip_markers, "target_markers": room.target_markers}
    (readings,), tip = observed(merging, 1, (tip[0] + 0.02, tip[1], tip[2]), **places)
    assert readings.target.occluded  # swapped with the tip, which has two visible markers
    assert readings.tip.pose[0] == pytest.approx(tip[0] + 0.02)


def test_stamps_have_random_delays_never_decrease_and_do_not_tell_the_latency():
    sensors = Sensors(Noise(vicon_jitter=0.002, vicon_latency=0.03), 1)
    for k in range(300):  # it moves at 1 m/s
        seen = sensors.observe(k, (k / RATE, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, RESTING).base
        age = k / RATE - 1e-9 * seen.age - seen.pose[0]
        assert k < 5 or 0.03 <= age <= 0.04
    sights, _ = observed(Noise(vicon_jitter=0.002), 1000)
    late = np.array([1.0 / RATE - 1e-9 * s.base.age for s in sights])
    assert late.min() >= 0.0
    assert late.max() <= 1.0 / RATE
    assert late.mean() == pytest.approx(0.002 * math.sqrt(2 / math.pi), rel=0.1)
    stamps = [k * FRAME - s.base.age for k, s in enumerate(sights)]
    assert (np.diff(stamps) > 0).all()
    assert all(s.base.age == 0 for s in observed(PRESETS["default"], 20)[0])


def make_beds_on_one_table(noise, room, *vehicles):
    """Return the test beds of vehicles (description, pose) that one VICON observes."""
    states, plants, kinds = [], [], []
    for name, (made, pose) in zip("ab", vehicles, strict=True):
        n = getattr(made, "n", 0)
        states.append(State(0, 1, 0, (*pose, *n * (0.0,)), (3 + n) * (0.0,)))
        plants.append(Vehicle(made, states[-1].q, states[-1].qd, World(), name=name))
        kinds += [BASE, TIP] if n else [BASE]
    bed = testbed.place_on_table(plants, states)
    vicon = Vicon(noise, room, 1, kinds)
    return [
        testbed.Testbed(made, noise, 1, state, bed=bed, number=k, vicon=vicon)
        for k, ((made, _), state) in enumerate(zip(vehicles, states, strict=True))
    ]


def test_a_vehicle_occludes_markers_of_another():
    arm, room = paper_arm(), replace(ONE, heights=(1.5, 0.3, 0.3))
    pose = -1.5, 0.0, -math.pi / 2
    x, y, _ = tip_pose(arm.vector(), [*pose, *arm.n * (0.0,)])
    for share, seen in ((0.15, 0), (0.6, 4)):  # of the way from there to the cameras
        other = x + share * (3.0 - x), y - share * y, 0.0
        vehicles = (arm, pose), (arm.base, other)
        one, other = make_beds_on_one_table(Noise(vicon_occlusion=1.0), room, *vehicles)
        sights = [report.readings for report in testbed.step([one, other])]
        assert (one.marker_results[BASE].markers, one.marker_results[TIP].markers) == (5, seen)
        assert other.marker_results[BASE].markers == 5
        assert TIP not in other.marker_results
        assert sights[0].tip.occluded == (not seen)


def test_vehicles_whose_markers_merge_may_be_swapped():
    poses, base = [(0.0, 0.0, 0.0), (0.42, 0.0, 0.0)], paper_arm().base
    for swap in (0.0, 1.0):
        noise = Noise(vicon_merge_distance=0.14, vicon_merge_swap=swap)
        beds = make_beds_on_one_table(noise, Room(), *((base, pose) for pose in poses))
        seen = [report.readings.base.pose for report in testbed.step(beds)]
        assert [bed.marker_results[BASE].markers for bed in beds] == [4, 4]
        np.testing.assert_allclose(seen, poses[::-1] if swap else poses, atol=1e-9)


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"cameras": (1.0, 2.0)}, "cameras has 2 numbers, expected 3 for each of at least 2"),
        ({"tip_markers": 4 * (0.0,)}, "has 4 numbers, expected 2 for each of at least 3"),
    ],
)
def test_a_room_with_too_few_cameras_or_markers_is_rejected(given, error):
    with pytest.raises(RoomError, match=error):
        Room(**given)
