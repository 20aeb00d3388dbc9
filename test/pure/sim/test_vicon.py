"""VICON by its markers: who is seen, how well, when subjects are lost or taken for each other."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_sim import testbed
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.plant import Vehicle, World
from fss_sim.sensors import RATE, Sensors, compose
from fss_sim.testbed import FRAME, State
from fss_sim.vicon import BASE, TARGET, TIP, Room, RoomError, Vicon

POSES = [(0.2, -0.1, 0.4), (1.1, 0.3, -0.7), (-1.0, 1.0, 2.0)]
KINDS = [BASE, TIP, TARGET]
STILL = np.zeros(4)


def cameras(room=None, seed=1, **noise):
    return Vicon(Noise(**noise), room or Room(), seed, KINDS)


def fitted(body, world):
    """Pose of points `body` (k,) seen at `world` (k,) by least squares, after Horn."""
    a, b = body - body.mean(), world - world.mean()
    turn = np.vdot(a, b)
    turn /= abs(turn)
    at = world.mean() - turn * body.mean()
    return at.real, at.imag, math.atan2(turn.imag, turn.real)


def test_a_pose_is_off_as_a_fit_to_the_markers_is():
    vicon, room = cameras(marker_noise=1e-5), Room()
    white = vicon._chance.normal(7).reshape(-1, 2) @ [1, 1j]
    begin = 0
    for kind, pose, look in zip(KINDS, POSES, vicon.look(7, POSES), strict=True):
        body = room.markers(kind)[:, :2] @ [1, 1j]
        world = complex(*pose[:2]) + np.exp(1j * pose[2]) * body
        world += 1e-5 * white[begin : begin + len(body)]
        begin += len(body)
        np.testing.assert_allclose(np.add(pose, look.error), fitted(body, world), rtol=0, atol=1e-7)
        assert (look.markers, look.taken_for) == (len(body), kind)


@pytest.mark.parametrize("kind", KINDS)
def test_noise_falls_with_the_root_of_the_markers_and_the_subjects_size(kind):
    vicon, sigma, room = cameras(marker_noise=0.0005), 0.0005, Room()
    errors = np.array([vicon.look(k, POSES)[kind].error for k in range(4000)])
    body = room.markers(kind)[:, :2] @ [1, 1j]
    apart, N = body - body.mean(), len(body)
    r = np.sqrt(np.mean(abs(apart) ** 2))
    middle = errors[:, 0] + 1j * errors[:, 1]
    middle += 1j * errors[:, 2] * np.exp(1j * POSES[kind][2]) * body.mean()  # at the centroid
    # 4000 draws know a deviation to 1.1%, 1 sigma.
    assert np.std(middle.real) == pytest.approx(sigma / math.sqrt(N), rel=0.045)
    assert np.std(middle.imag) == pytest.approx(sigma / math.sqrt(N), rel=0.045)
    assert np.std(errors[:, 2]) == pytest.approx(sigma / (r * math.sqrt(N)), rel=0.045)


def test_the_edge_is_seen_worse_and_always_the_same():
    def off(x, y=0.0, seed=1):
        looks = cameras(vicon_edge_error=0.002, seed=seed).look(0, [(x, y, 0.0), *POSES[1:]])
        return np.array(looks[BASE].error)

    middle, half, edge = (np.hypot(*off(x)[:2]) for x in (0.05, 1.0, 2.0))
    assert middle < 1e-5
    assert half == pytest.approx(0.002 / 8, rel=0.1)  # the markers lie around 1 m
    assert edge == pytest.approx(0.002, rel=0.03)
    np.testing.assert_array_equal(off(1.5, -1.0), off(1.5, -1.0))
    assert np.abs(off(1.5) - off(1.5, seed=2)).max() > 1e-5


ONE = Room(cameras=(3.0, 0.0, 3.0, 3.0, 0.1, 3.0))  # both on one side


def bodies(*rows):
    return [[x, y, x, y, radius, height] for x, y, radius, height in rows]


def test_a_body_between_a_subject_and_its_cameras_hides_it():
    vicon = cameras(ONE, vicon_occlusion=1.0)
    poses = [(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.5, 0.0)]
    # From x = -1, 0.33 m up, sight rises by 2.67 m in 4 m: at x = -0.8 it is 0.46 m up.
    tall, low, beside = (-0.7, 0.0, 0.15, 0.6), (-0.7, 0.0, 0.15, 0.4), (-0.7, 0.5, 0.15, 0.6)
    for stands, seen in ((tall, False), (low, True), (beside, True)):
        base, tip, target = vicon.look(0, poses, bodies(stands))
        assert (base.there, tip.there, target.there) == (True, seen, True), stands
    # Whoever has cameras all around sees it from the other side.
    assert cameras(vicon_occlusion=1.0).look(0, poses, bodies(tall))[TIP].there
    assert cameras(ONE).look(0, poses, bodies(tall))[TIP].there  # nothing hides


def test_a_link_hides_along_its_whole_length():
    vicon = cameras(ONE, vicon_occlusion=1.0)
    poses = [(0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.5, 0.0)]
    for y, seen in ((0.1, False), (-0.6, True)):
        row = [[-0.75, y - 0.3, -0.75, y + 0.3, 0.06, 0.6]]
        assert vicon.look(0, poses, row)[TIP].there == seen


def test_what_is_left_of_the_markers_makes_the_pose_worse():
    room = replace(ONE, tip_markers=(-0.3, 0.0, 0.0, 0.1, 0.3, 0.0, 0.0, -0.1))
    vicon = cameras(room, vicon_occlusion=1.0, marker_noise=0.001)
    poses = [(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.5, 0.0)]
    hides = bodies((-0.9, 0.0, 0.05, 0.6))  # behind which the rearmost marker lies, and no other
    counts, errors = [], []
    for k in range(2000):
        look = vicon.look(k, poses, hides)[TIP]
        counts.append(look.markers)
        errors.append(look.error)
    assert set(counts) == {3}
    whole = [vicon.look(k, poses)[TIP].error for k in range(2000)]
    assert np.std(errors, axis=0)[2] > 1.2 * np.std(whole, axis=0)[2]


def near(distance):
    """Tip and target with one marker each that far apart."""
    room = Room(
        tip_markers=(0.0, 0.0, -0.1, 0.05, -0.1, -0.05),
        target_markers=(0.0, 0.0, 0.1, 0.08, 0.1, -0.06, 0.2, 0.0),
    )
    return room, [(-1.5, 0.0, 0.0), (0.0, 0.0, 0.0), (distance, 0.0, 0.0)]


def test_markers_that_come_too_near_are_lost_to_both_subjects():
    room, poses = near(0.02)
    base, tip, target = cameras(room, vicon_merge_distance=0.03).look(0, poses)
    assert (base.markers, tip.markers, target.markers) == (5, 2, 3)
    assert (tip.there, target.there) == (False, True)
    apart = cameras(room, vicon_merge_distance=0.03).look(0, near(0.04)[1])
    assert [look.markers for look in apart] == [5, 3, 4]


def test_a_merge_swaps_its_subjects_or_does_not_until_it_ends():
    room, poses = near(0.02)
    swapped = 0
    for seed in range(400):
        vicon = cameras(room, seed=seed, vicon_merge_distance=0.03, vicon_merge_swap=0.3)
        during = {tuple(look.taken_for for look in vicon.look(k, poses)) for k in range(5)}
        assert len(during) == 1  # one lot for all of it
        assert during <= {(0, 1, 2), (0, 2, 1)}
        swapped += during == {(0, 2, 1)}
        after = vicon.look(5, near(0.2)[1])
        assert [look.taken_for for look in after] == KINDS
    assert swapped / 400 == pytest.approx(0.3, abs=4 * math.sqrt(0.21 / 400))


def observed(noise, frames, target=None, **room):
    base, tip = (0.1, 0.2, 0.3), (1.0, 0.5, 0.2)
    poses = [base, compose(base, tip), *([target] if target else [])]
    sensors, vicon = Sensors(noise, 1), Vicon(noise, Room(**room), 1, KINDS[: len(poses)])
    return [
        sensors.observe(
            k, base, tip, 0.0, STILL, target=target, looks=dict(enumerate(vicon.look(k, poses)))
        )
        for k in range(frames)
    ], poses[TIP]


def test_the_sensors_report_what_the_cameras_make_of_it():
    (sight,), tip = observed(Noise(vicon_edge_error=1e-9), 1, (-1.0, 0.0, 0.0))
    np.testing.assert_allclose(sight.tip.pose, tip, atol=1e-8)
    room, _ = near(0.0)
    merging = Noise(vicon_merge_distance=0.03, vicon_merge_swap=1.0)
    places = {"tip_markers": room.tip_markers, "target_markers": room.target_markers}
    (sight,), tip = observed(merging, 1, (tip[0] + 0.02, tip[1], tip[2]), **places)
    assert sight.target.occluded  # as it is taken for the tip, which has two markers left
    assert sight.tip.pose[0] == pytest.approx(tip[0] + 0.02)


def test_stamps_come_later_by_chance_and_never_run_back():
    sights, _ = observed(Noise(vicon_jitter=0.002), 1000)
    late = np.array([1.0 / RATE - 1e-9 * s.base.before for s in sights])
    assert late.min() >= 0.0
    assert late.max() <= 1.0 / RATE
    assert late.mean() == pytest.approx(0.002 * math.sqrt(2 / math.pi), rel=0.1)
    stamps = [k * FRAME - s.base.before for k, s in enumerate(sights)]
    assert (np.diff(stamps) > 0).all()
    assert all(s.base.before == 0 for s in observed(PRESETS["default"], 20)[0])


def test_a_stamp_is_that_of_a_pose_older_by_the_latency_and_the_jitter():
    sensors = Sensors(Noise(vicon_jitter=0.002, vicon_latency=0.03), 1)
    for k in range(300):  # it moves at 1 m/s
        seen = sensors.observe(k, (k / RATE, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, STILL).base
        age = k / RATE - 1e-9 * seen.before - seen.pose[0]
        assert k < 5 or 0.03 <= age <= 0.04


def test_the_test_bed_hides_its_subjects_behind_its_own_bodies():
    # The base, 1.5 m high, stands between the cameras and the tip of the stretched arm.
    low = Room(cameras=(3.0, 1.0, 3.0, 3.0, 1.1, 3.0))
    begin = State(0, 1, 0, (0.0, 0.0, math.pi, 0.0, 0.0, 0.0, 0.0), (0.0,) * 7)
    for stands, seen in ((low, 4), (replace(low, heights=(1.5, 0.3, 0.3)), 0)):
        noise = Noise(vicon_occlusion=1.0)
        vicon = Vicon(noise, stands, 1, [BASE, TIP])
        bed = testbed.Testbed(paper_arm(), noise, 1, begin, vicon=vicon)
        sight = bed.step().sight
        base, tip = bed.looks[BASE], bed.looks[TIP]
        assert (base.markers, tip.markers) == (5, seen)
        assert (sight.base.occluded, sight.tip.occluded) == (False, not seen)


def on_one_table(noise, room, *vehicles):
    """Test beds of vehicles (description, pose) that one VICON looks at."""
    states, plants, kinds = [], [], []
    for name, (made, pose) in zip("ab", vehicles, strict=True):
        n = getattr(made, "n", 0)
        states.append(State(0, 1, 0, (*pose, *n * (0.0,)), (3 + n) * (0.0,)))
        plants.append(Vehicle(made, states[-1].q, states[-1].qd, World(), name=name))
        kinds += [BASE, TIP] if n else [BASE]
    testbed.together(plants, states)
    vicon = Vicon(noise, room, 1, kinds)
    return [
        testbed.Testbed(made, noise, 1, state, plant=plant, vicon=vicon)
        for (made, _), state, plant in zip(vehicles, states, plants, strict=True)
    ]


def test_a_vehicle_hides_anothers_markers():
    arm, room = paper_arm(), replace(ONE, heights=(1.5, 0.3, 0.3))
    pose = -1.5, 0.0, -math.pi / 2
    x, y, _ = tip_pose(arm.vector(), [*pose, *arm.n * (0.0,)])
    for share, seen in ((0.15, 0), (0.6, 4)):  # of the way from there to the cameras
        other = x + share * (3.0 - x), y - share * y, 0.0
        vehicles = (arm, pose), (arm.base, other)
        one, other = on_one_table(Noise(vicon_occlusion=1.0), room, *vehicles)
        sights = [report.sight for report in testbed.step([one, other])]
        assert (one.looks[BASE].markers, one.looks[TIP].markers) == (5, seen)
        assert other.looks[BASE].markers == 5
        assert TIP not in other.looks
        assert sights[0].tip.occluded == (not seen)


def test_vehicles_whose_markers_merge_may_be_taken_for_each_other():
    poses, base = [(0.0, 0.0, 0.0), (0.42, 0.0, 0.0)], paper_arm().base
    for swap in (0.0, 1.0):
        noise = Noise(vicon_merge_distance=0.14, vicon_merge_swap=swap)
        beds = on_one_table(noise, Room(), *((base, pose) for pose in poses))
        seen = [report.sight.base.pose for report in testbed.step(beds)]
        assert [bed.looks[BASE].markers for bed in beds] == [4, 4]
        np.testing.assert_allclose(seen, poses[::-1] if swap else poses, atol=1e-9)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"cameras": (1.0, 2.0)}, "cameras has 2 numbers, expected 3 of each, and of 2 at least"),
        ({"tip_markers": (0.0,) * 4}, "tip_markers has 4 numbers, expected 2 of each, and of 3"),
    ],
)
def test_a_room_without_enough_in_it_is_refused(given, complaint):
    with pytest.raises(RoomError, match=complaint):
        Room(**given)
