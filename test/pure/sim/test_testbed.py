"""Sensors and test bed: stated errors, reproducibility by seed, resuming."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from fss_arm_driver.protocol import decode
from fss_arm_model.description import paper_arm
from fss_sim import testbed
from fss_sim.faults import Event, GyroFaults, SubjectFaults
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.joints import PRESETS as JOINTS
from fss_sim.plant.joints import outboard_momentum
from fss_sim.plant.vehicle import World
from fss_sim.sensors import NO_SUBJECT_FAULTS, RATE, Sensors
from fss_sim.testbed import OUTAGE_FRAMES, State, StateError

BEGIN = State(frame=0, boots=1, rests=0, q=(0.0,) * 7, qd=(0.0,) * 7, boot_offset=0)
RESTING, MOVING = np.zeros(4), np.full(4, 0.1)


def seen_from_base(readings):
    (x, y, theta), (u, v, phi) = readings.base.pose, readings.tip.pose
    z = complex(u - x, v - y) * np.exp(-1j * theta)
    return z.real, z.imag, phi - theta


def test_each_rest_has_its_own_error_of_the_stated_size():
    sensors, errors = Sensors(PRESETS["paper"], seed=3), []
    base, tip = (0.4, -0.1, 2.0), (1.2, 0.3, 0.5)
    for rest in range(1500):
        for k in range(RATE // 5):
            readings = sensors.observe(rest * RATE + k, base, tip, 0.0, RESTING)
        errors.append(np.subtract(seen_from_base(readings), tip))
        sensors.observe(rest * RATE + 99, base, tip, 0.0, MOVING)
    deviation = np.std(errors, axis=0)
    # 1500 draws know a deviation to 1.8%, 1 sigma; the white noise adds under 0.1%.
    np.testing.assert_allclose(deviation[:2], 0.0177, rtol=0.07)
    assert deviation[2] == pytest.approx(math.radians(0.715), rel=0.07)
    assert np.abs(np.mean(errors, axis=0) / deviation).max() < 4 / math.sqrt(1500)


def test_the_error_of_a_rest_is_constant():
    sensors = Sensors(PRESETS["paper"], seed=1)
    sights = [sensors.observe(k, (0, 0, 0), (1, 0, 0), 0.0, RESTING).tip.pose for k in range(200)]
    white = np.std(sights, axis=0)
    np.testing.assert_allclose(white, [3e-4, 3e-4, math.radians(0.05)], rtol=0.2)


def run(bed, frames):
    return [bed.step() for _ in range(frames)]


@pytest.mark.parametrize("preset", ["paper", "laboratory"])
def test_the_same_seed_gives_the_same_frames_and_another_does_not(preset):
    noise, world = PRESETS[preset], World(JOINTS[preset])
    first, second, other = (
        run(testbed.Testbed(paper_arm(), noise, seed, BEGIN, world=world), 60) for seed in (1, 1, 2)
    )
    assert first == second
    assert [r.readings for r in first] != [r.readings for r in other]


def test_boot_numbers_cover_their_field_and_differ():
    boots = [State(0, 1, 0, q=(), qd=()).boot for _ in range(1000)]
    assert min(boots) >= 1
    assert max(boots) <= 65535
    assert len(set(boots)) > 950  # 992 of 65535 are expected
    counted = [replace(BEGIN, boots=k, boot_offset=65533).boot for k in range(1, 5)]
    assert counted == [65534, 65535, 1, 2]


def test_the_boot_number_changes_no_measurement_and_no_fault():
    script = [
        Event(0.1, "link_1", "loss", 0.3),
        Event(0.1, "link_2", "jitter", 0.05),
        Event(0.1, "link_3", "reset", duration=0.1),
        Event(0.1, "board", "duplication", 0.5),
    ]
    options = {"rate": 20.0, "script": script, "board_rate": 20.0}
    readings, frames = [], []
    for offset in (0, 40_000):
        state = replace(BEGIN, boot_offset=offset)
        reports = run(testbed.Testbed(paper_arm(), PRESETS["paper"], 1, state, **options), 100)
        readings.append([r.readings for r in reports])
        sent = [d.data for r in reports for each in (*r.telemetry, r.board) for d in each]
        frames.append([data[:6] + data[8:52] for data in sent])  # without boot number and CRC
    assert readings[0] == readings[1]
    assert frames[0] == frames[1]
    assert len(frames[0]) > 100


def test_torque_sensors_measure_shear_by_crosstalk():
    noise, arm = replace(PRESETS["ideal"], torque_crosstalk=0.002), paper_arm()
    bed = testbed.Testbed(arm, noise, 1, BEGIN)
    before = outboard_momentum(bed.plant.p, bed.plant.q, bed.plant.qd)
    bed.plant.thrust([0.05] * 4 + [0.0] * 4)
    bed.step()
    forces = RATE * (outboard_momentum(bed.plant.p, bed.plant.q, bed.plant.qd) - before)
    turns = [bed.plant.q[2] + arm.base.mount[2], *bed.plant.q[3:] + [k.theta_0 for k in arm.links]]
    along = np.cumsum(turns)[1:]
    across = forces[:, 1] * np.cos(along) - forces[:, 0] * np.sin(along)
    assert np.abs(across).max() > 0.01
    np.testing.assert_allclose([m.shear for m in bed._motions], across, rtol=1e-9)
    bed = testbed.Testbed(arm, PRESETS["ideal"], 1, BEGIN)
    bed.plant.thrust([0.05] * 4 + [0.0] * 4)
    bed.step()
    assert [m.shear for m in bed._motions] == [0.0] * 4  # not computed without crosstalk


def test_it_resumes_after_the_last_reported_time_with_restarted_links(tmp_path):
    bed = testbed.Testbed(paper_arm(), PRESETS["paper"], 1, BEGIN)
    run(bed, 50)
    bed.state().save(tmp_path / "state.json")
    kept = State.load(tmp_path / "state.json", 4)
    assert kept == bed.state()
    resumed = kept.after_restart()
    assert (resumed.frame, resumed.boots) == (50 + OUTAGE_FRAMES, 2)
    again = testbed.Testbed(paper_arm(), PRESETS["paper"], 1, resumed)
    np.testing.assert_array_equal(again.plant.q, bed.plant.q)
    report = next(r for r in (again.step() for _ in range(100)) if r.telemetry[0])
    assert decode(report.telemetry[0][0].data).boot == 2


def test_a_state_file_without_a_boot_offset_is_read(tmp_path):
    BEGIN.save(tmp_path / "state.json")
    given = json.loads((tmp_path / "state.json").read_text())
    del given["boot_offset"]
    (tmp_path / "state.json").write_text(json.dumps(given))
    assert replace(State.load(tmp_path / "state.json", 4), boot_offset=0) == BEGIN


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        10**5 * "[",
        '{"frame": .inf, "boots": 1, "rests": 0}',
        '{"frame": 1, "boots": 1, "rests": 0, "q": [0], "qd": [0]}',
    ],
)
def test_an_invalid_state_file_is_rejected_by_name(tmp_path, text):
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(StateError, match=r"state\.json") as error:
        State.load(path, 4)
    assert "\n" not in str(error.value)
    assert "Error(" not in str(error.value)


def observe_with_faults(faults, frames=2000, of_target=NO_SUBJECT_FAULTS, **gyro):
    sensors, at_rest = Sensors(PRESETS["ideal"], seed=1), ((1.0, 0.0, 0.0), 0.1, RESTING)
    injected = faults, NO_SUBJECT_FAULTS, GyroFaults(**gyro)
    target = {"target": (3.0, 2.0, 1.0), "target_faults": of_target}
    poses = [(0.01 * k, 0.0, 0.5) for k in range(frames)]
    return [sensors.observe(k, pose, *at_rest, *injected, **target) for k, pose in enumerate(poses)]


def test_dropouts_occlusions_and_swaps_have_the_given_shares_and_are_independent():
    def readings(**fault):
        return observe_with_faults(SubjectFaults(**fault), of_target=SubjectFaults(**fault))

    missed = np.array([(s.base is None, s.target is None) for s in readings(dropout=0.3)])
    occluded = np.array([(s.base.occluded, s.target.occluded) for s in readings(occlusion=0.3)])
    swaps = observe_with_faults(NO_SUBJECT_FAULTS, of_target=SubjectFaults(swap=0.3))
    swapped = np.array([s.target.pose == s.base.pose for s in swaps])
    shares = [*missed.mean(axis=0), *occluded.mean(axis=0), swapped.mean()]
    np.testing.assert_allclose(shares, 0.3, rtol=0, atol=4 * (0.21 / 2000) ** 0.5)
    for pair in (missed, occluded):  # both by chance
        assert pair.all(axis=1).mean() == pytest.approx(0.09, abs=4 * (0.09 * 0.91 / 2000) ** 0.5)
    assert not any(s.tip.occluded for s in readings(occlusion=1.0))


def test_vicon_poses_can_be_late_turned_or_frozen():
    late = [s.base.pose[0] for s in observe_with_faults(SubjectFaults(latency=0.2), 100)]
    np.testing.assert_allclose(late[20:], 0.01 * np.arange(80), atol=1e-12)
    swapped = observe_with_faults(SubjectFaults(swap=1.0), 3)[-1]
    assert swapped.base == swapped.tip != observe_with_faults(NO_SUBJECT_FAULTS, 3)[-1].base
    turned = observe_with_faults(SubjectFaults(turn=math.pi / 2), 3)[-1].base.pose
    assert turned == (0.02, 0.0, 0.5 + math.pi / 2)
    sensors, poses = Sensors(PRESETS["default"], seed=1), []
    for k in range(10):
        faults = SubjectFaults(frozen=k >= 5)
        seen = sensors.observe(k, (0.01 * k, 0, 0), (1, 0, 0), 0.0, RESTING, faults)
        poses.append(seen.base)
    assert len(set(poses[:5])) == 5
    assert set(poses[4:]) == {poses[4]}


def test_the_gyro_has_bias_random_walk_and_scale_error():
    biased = [s.rate for s in observe_with_faults(NO_SUBJECT_FAULTS, 3, bias=0.02)]
    assert biased == pytest.approx([0.12] * 3)
    missed = [s.rate is None for s in observe_with_faults(NO_SUBJECT_FAULTS, dropout=0.5)]
    assert sum(missed) == pytest.approx(1000, abs=90)
    scales, walks = [], []
    for seed in range(300):
        sensors = Sensors(Noise(gyro_scale=1e-3, gyro_walk=1e-4), seed)
        at_rest = (0, 0, 0), (1, 0, 0), 1.0, RESTING
        seen = [sensors.observe(k, *at_rest).rate - 1.0 for k in (0, 2500, 2550)]
        scales.append(seen[0])
        walks.append(seen[1] - seen[0])
        assert abs(seen[2] - seen[1]) < 5e-4  # no step
    assert np.std(scales) == pytest.approx(1e-3, rel=0.17)  # 4 sigma of 300 draws
    assert np.std(walks) == pytest.approx(5e-4, rel=0.17)  # after 25 s


def test_vicon_noise_can_be_held_for_some_frames():
    noise = Noise(position_noise=0.001, heading_noise=0.01, vicon_hold=0.1)
    sensors, fresh = Sensors(noise, 3), Sensors(replace(noise, vicon_hold=0.0), 3)
    still = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, np.zeros(4))
    held = [sensors.observe(k, *still).base.pose for k in range(600)]
    assert len(set(held)) == 60
    assert all(len(set(held[k : k + 10])) == 1 for k in range(0, 600, 10))
    assert len({fresh.observe(k, *still).base.pose for k in range(600)}) == 600
