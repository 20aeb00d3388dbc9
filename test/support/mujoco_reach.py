"""FssReach-v0 in MuJoCo, one environment at a time, as it would be written without this project."""

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from model_oracles import mujoco_model

from fss_arm_model.description import Arm, paper_arm
from fss_sim.environments.batch import LIMIT_MARGIN, PERIOD, STEPS
from fss_sim.environments.tasks import Reach


class MujocoReach(gymnasium.Env):
    def __init__(self, arm: Arm | None = None) -> None:
        self.arm = arm or paper_arm()
        self.model, n = mujoco_model(self.arm), self.arm.n
        off = mujoco.mjtDisableBit
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        self.model.opt.timestep = PERIOD / STEPS
        self.model.opt.disableflags |= off.mjDSBL_CONSTRAINT.value | off.mjDSBL_CONTACT.value
        self.data, self.H = mujoco.MjData(self.model), np.zeros((3 + n, 3 + n))
        drives = [link.drive for link in self.arm.links]
        self.max_rate = np.array([drive.max_velocity for drive in drives])
        self.max_acceleration = np.array([drive.max_acceleration for drive in drives])
        self.max_torque = np.array([drive.max_torque for drive in drives])
        self.q_min = np.array([link.q_min for link in self.arm.links])
        self.q_max = np.array([link.q_max for link in self.arm.links])
        self.last = self.model.body(f"link_{n}").id
        self.observation_space = spaces.Box(-np.inf, np.inf, (2 * n + 7,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (n,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        rng = self.np_random
        self.start(0.7 * rng.uniform(self.q_min, self.q_max), np.array([1.0, 0.5, 0.3]))
        return self.observe(), {}

    def start(self, q_m, fixture, heading=0.0):
        self.data.qpos[:], self.data.qvel[:] = [0.0, 0.0, heading, *q_m], 0.0
        self.fixture, self.periods = fixture, 0
        mujoco.mj_forward(self.model, self.data)

    def tip(self):
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        x, y = self.data.xpos[self.last][:2]
        along = self.data.xmat[self.last].reshape(3, 3)[:2, 0]
        length = self.arm.links[-1].a
        velocity = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, kind, self.last, velocity, 0)
        turn = velocity[2]
        vx = velocity[3] - turn * length * along[1]
        vy = velocity[4] + turn * length * along[0]
        heading = np.arctan2(along[1], along[0])
        return np.array([x + length * along[0], y + length * along[1], heading]), (vx, vy, turn)

    def step(self, action):
        action = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        rates, q = action * self.max_rate, self.data.qpos
        rates[(q[3:] < self.q_min + LIMIT_MARGIN) & (rates < 0.0)] = 0.0
        rates[(q[3:] > self.q_max - LIMIT_MARGIN) & (rates > 0.0)] = 0.0
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_fullM(self.model, self.data, self.H)
        H, h = self.H, self.data.qfrc_bias
        qdd = (rates - self.data.qvel[3:]) / PERIOD
        qdd = np.clip(qdd, -self.max_acceleration, self.max_acceleration)
        base = np.linalg.solve(H[:3, :3], -h[:3] - H[:3, 3:] @ qdd)
        torque = H[3:, :3] @ base + H[3:, 3:] @ qdd + h[3:]
        self.data.qfrc_applied[3:] = np.clip(torque, -self.max_torque, self.max_torque)
        mujoco.mj_step(self.model, self.data, STEPS)
        self.periods += 1
        pose, twist = self.tip()
        distance = np.hypot(*(self.fixture - pose)[:2])
        turn = abs((self.fixture[2] - pose[2] + np.pi) % (2.0 * np.pi) - np.pi)
        arrived = bool(distance < 0.01 and turn < 0.05 and np.hypot(*twist[:2]) < 0.02)
        cost = distance + 0.2 * turn + 0.05 * np.mean(action**2)
        truncated = self.periods >= round(Reach.duration / PERIOD)
        return self.observe(), 10.0 * arrived - PERIOD * cost, arrived, truncated, {}

    def observe(self):
        pose, _ = self.tip()
        c, s = np.cos(self.data.qpos[2]), np.sin(self.data.qpos[2])
        vx, vy, turn_rate = self.data.qvel[:3]
        x, y, turn = self.fixture - pose
        parts = [
            *self.data.qpos[3:], *self.data.qvel[3:], c * vx + s * vy, c * vy - s * vx, turn_rate,
            c * x + s * y, c * y - s * x, np.cos(turn), np.sin(turn),
        ]  # fmt: skip
        return np.array(parts, dtype=np.float32)
