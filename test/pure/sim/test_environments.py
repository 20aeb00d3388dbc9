"""Learning environments: Gymnasium's own checks, MuJoCo's dynamics, momentum, and the tasks."""

import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from model_arms import random_arm
from mujoco_reach import MujocoReach

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_model.files import ContentError
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import momentum
from fss_sim.environments.batch import PERIOD
from fss_sim.environments.register import register_environments
from fss_sim.environments.tasks import TASKS, draw_postures, draw_start

NAMES = list(TASKS)


@pytest.fixture(scope="module", autouse=True)
def registered():
    register_environments()


@pytest.mark.filterwarnings("ignore:.*Box observation space m.*imum value is")
@pytest.mark.parametrize("name", NAMES)
def test_gymnasiums_checks_pass(name):
    check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("n", [3, 8])
@pytest.mark.parametrize("name", NAMES)
def test_any_number_of_links(name, n, tmp_path):
    save(random_arm(n, np.random.default_rng(n)), tmp_path / "arm.yaml")
    envs = gymnasium.make_vec(name, num_envs=5, arm=str(tmp_path / "arm.yaml"))
    observation, _ = envs.reset(seed=1)
    assert observation.shape == (5, len(envs.episodes.task.names))
    observation, reward, *_ = envs.step(envs.action_space.sample())
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()


def test_it_moves_as_mujoco_does():
    """Both integrate with the same method and step; observations are single precision."""
    ours, peer = gymnasium.make("FssReach-v0").unwrapped, MujocoReach()
    ours.reset(seed=3)
    batch, task = ours.episodes.task.batch, ours.episodes.task
    peer.start(batch.q[0, 3:], task.fixture[0], batch.q[0, 2])
    rng = np.random.default_rng(0)
    for k in range(200):
        if k % 20 == 0:
            action = rng.uniform(-0.5, 0.5, 4).astype(np.float32)
        got, expected = ours.step(action), peer.step(action)
        np.testing.assert_allclose(got[0], expected[0], atol=1e-6)
        assert got[1] == pytest.approx(expected[1], abs=1e-9)
        assert got[2:4] == expected[2:4]


def test_momentum_is_conserved_without_thrusters():
    envs = gymnasium.make_vec("FssReach-v0", num_envs=20)
    envs.reset(seed=2)
    envs.action_space.seed(2)
    batch = envs.episodes.task.batch
    for _ in range(100):
        envs.step(envs.action_space.sample())
    assert np.abs(batch.qd[:, 3:]).max() > 0.1
    # The integration conserves linear momentum exactly, angular momentum to its order.
    drift = momentum(batch.p, batch.q, batch.qd)
    np.testing.assert_allclose(drift[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(drift[:, 2], 0.0, atol=1e-7)


def test_each_fixture_can_be_reached():
    """The posture that it was drawn for brings the end effector there, while the base floats."""
    envs = gymnasium.make_vec("FssReach-v0", num_envs=50, randomize={"m_0": {"uniform": [5, 15]}})
    envs.reset(seed=6)
    task, rows = envs.episodes.task, np.arange(50)
    task.reset(rows, np.random.default_rng(6))
    rng = np.random.default_rng(6)
    draw_start(task.batch, rows, rng)  # the same again
    postures, arrived = draw_postures(task.batch, 50, rng), np.zeros(50, dtype=bool)
    for _ in range(300):
        way = postures - task.batch.q[:, 3:]
        furthest = np.abs(way).max(axis=1, keepdims=True)
        arrived |= task.step(0.2 * way / np.maximum(furthest, 0.1)).terminated  # straight
    assert arrived.all()


def test_drives_follow_rates_within_their_limits():
    envs = gymnasium.make_vec("FssHold-v0", num_envs=4)
    envs.reset(seed=0)
    batch = envs.episodes.task.batch
    batch.q[:, 3:] = 0.0
    rates = np.tile([0.3, -0.3, 0.3, -0.3], (4, 1))
    for _ in range(20):
        batch.advance(np.zeros((4, 3)), rates)
    np.testing.assert_allclose(batch.qd[:, 3:], rates, atol=0.01)
    for _ in range(200):
        batch.advance(np.zeros((4, 3)), rates)
    assert (batch.q[:, 3:] <= batch.q_max).all()
    assert (batch.q[:, 3:] >= batch.q_min).all()
    assert (np.abs(batch.torque) <= batch.max_torque).all()
    np.testing.assert_allclose(batch.qd[:, 3:], 0.0, atol=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_moves_as_its_rows_alone(name):
    envs = gymnasium.make_vec(name, num_envs=3)
    envs.reset(seed=5)
    one = gymnasium.make(name).unwrapped
    one.reset(seed=5)
    batch, alone = envs.episodes.task.batch, one.episodes.task.batch
    alone.q[0], alone.qd[0] = batch.q[1], batch.qd[1]
    wrench, rates = np.full((3, 3), 0.05), np.full((3, 4), 0.1)
    for _ in range(20):
        batch.advance(wrench, rates)
        alone.advance(wrench[:1], rates[:1])
    np.testing.assert_allclose(alone.q[0], batch.q[1], atol=1e-12)


def test_an_arrival_ends_the_episode_and_the_next_step_starts_another():
    envs = gymnasium.make_vec("FssReach-v0", num_envs=3)
    envs.reset(seed=1)
    task, still = envs.episodes.task, np.zeros((3, 4), dtype=np.float32)
    task.fixture[1] = tip_pose(task.batch.p[1], task.batch.q[1])
    _, reward, terminated, truncated, _ = envs.step(still)
    assert terminated.tolist() == [False, True, False]
    assert reward[1] == pytest.approx(10.0, abs=1e-9)
    assert not truncated.any()
    before = task.fixture.copy()
    _, reward, terminated, _, _ = envs.step(still)
    assert reward[1] == 0.0
    assert not terminated.any()
    assert (task.fixture != before).any(axis=1).tolist() == [False, True, False]


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_is_cut_off_after_its_duration(name):
    env = gymnasium.make(name)
    env.reset(seed=1)
    still, periods = np.zeros(env.action_space.shape, dtype=np.float32), 1
    while not (step := env.step(still))[3]:
        periods += 1
        assert not step[2]
    assert periods == round(TASKS[name].duration / PERIOD)


def test_the_gripper_must_be_at_the_fixture_and_as_fast():
    envs = gymnasium.make_vec("FssCapture-v0", num_envs=3)
    envs.reset(seed=1)
    task = envs.episodes.task
    tip = tip_pose(task.batch.p, task.batch.q)
    task.twist[:] = 0.0
    task.pose[:, 2] = tip[:, 2] + np.pi
    fixture = 0.19 * np.column_stack([np.cos(task.pose[:, 2]), np.sin(task.pose[:, 2])])
    task.pose[:, :2] = tip[:, :2] - fixture  # the gripper is at the fixture
    task.pose[1, :2] += 0.05  # not there
    task.twist[2, 0] = 0.15  # too fast
    _, reward, terminated, *_ = envs.step(np.zeros((3, 7), dtype=np.float32))
    assert terminated.tolist() == [True, False, False]
    assert reward[0] > 9.9
    task.pose[1, :2] = tip[1, :2]  # inside the target
    _, reward, terminated, *_ = envs.step(np.zeros((3, 7), dtype=np.float32))
    assert terminated[1]
    assert reward[1] < -9.9


def test_parameters_are_drawn_for_each_episode():
    given = {"m_0": {"uniform": [8.0, 12.0]}, "I_4": {"choice": [0.01, 0.02]}}
    envs = gymnasium.make_vec("FssHold-v0", num_envs=50, randomize=given)
    envs.reset(seed=1)
    mass = envs.episodes.task.batch.p[:, 0]
    assert 8.0 <= mass.min() < 8.5
    assert 11.5 < mass.max() <= 12.0
    with pytest.raises(ContentError, match="randomize is 'm_7', expected one of m_0"):
        gymnasium.make("FssHold-v0", randomize={"m_7": {"uniform": [1.0, 2.0]}})
    with pytest.raises(ContentError, match="randomize: m_0"):
        gymnasium.make("FssHold-v0", randomize={"m_0": [1.0, 2.0]})


def test_a_seed_starts_a_cycle_of_arms_again():
    env = gymnasium.make("FssHold-v0", randomize={"m_0": {"cycle": [8.0, 12.0]}})
    batch = env.unwrapped.episodes.task.batch
    masses = [(env.reset(seed=seed), float(batch.p[0, 0]))[1] for seed in (1, 1, None, 2)]
    assert masses == [8.0, 8.0, 12.0, 8.0]


def test_the_code_of_the_page_runs(capsys):
    page = (Path(__file__).parents[3] / "docs/how-to/learning.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    exec(compile(code, "learning.md", "exec"), {})
    assert "fixture x [m]" in capsys.readouterr().out


def test_a_simple_law_holds_the_base():
    """PD control by the documented order and units of the observation earns its reward."""
    envs = gymnasium.make_vec("FssHold-v0", num_envs=10)
    observation, _ = envs.reset(seed=4)
    names, n = envs.episodes.task.names, paper_arm().n
    assert names[2 * n : 2 * n + 3] == (
        "base v_x [m/s]",
        "base v_y [m/s]",
        "base turn rate [rad/s]",
    )
    total = np.zeros(10)
    for _ in range(1200):
        velocity, offset = observation[:, 8:11], observation[:, 11:]
        error = np.column_stack([offset[:, :2], offset[:, 3]])
        wrench = [20.0, 20.0, 10.0] * (0.1 * error - 0.6 * velocity)
        observation, reward, *_ = envs.step(wrench / [0.32, 0.32, 0.07])
        total += reward
    assert total.mean() > 40.0  # of 60
