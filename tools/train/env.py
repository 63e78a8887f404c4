"""The Go2 velocity task, for `train.py`: commands, sensor noise, delay, pushes, resets."""

from __future__ import annotations

import contract
import numpy as np
from physics import QPOS, QVEL, Physics
from rewards import Tick, reward_terms

EPISODE_STEPS = 1000
IDLE_STEPS = 30  # on four feet under a command: as bad as a fall, or standing wins over learning
NUM_CRITIC = contract.NUM_OBS + 3 + 1 + 4 + 4 + 3
BIAS_TIME = 0.5  # over which errors of speed are averaged in [s]: a stride of the trot or so
# Half widths of uniform sensor noise, in the observation's units before scaling.
NOISE = np.concatenate([[0.15] * 3, [0.04] * 3, [0.0] * 3, [0.012] * 12, [0.6] * 12, [0.0] * 12])
# A little beyond what is asked for, up to what `integral.py` may tell.
COMMAND_LOW = np.array([-0.8, -0.6, -1.4])
COMMAND_HIGH = np.array([1.2, 0.6, 1.4])


def rotate_inverse(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """World vectors (n, 3) in the frame of unit quaternions wxyz (n, 4)."""
    w, xyz = quat[:, :1], quat[:, 1:]
    cross = 2.0 * np.cross(xyz, vector)
    return vector - w * cross + np.cross(xyz, cross)


class Go2Env:
    """`num_envs` robots that follow random velocity commands; finished episodes restart at once.

    `cost_scale` fades in the costs and `push_speed` [m/s] the pushes; `train.py` schedules both.
    `reward_scale` changes the weight of terms by name.
    """

    physics_type = Physics
    episode_steps = EPISODE_STEPS
    num_obs, num_critic = contract.NUM_OBS, NUM_CRITIC

    def __init__(
        self,
        num_envs: int,
        timestep: float,
        seed: int,
        threads: int,
        pool: int = 256,
        feet_only: bool = True,
    ) -> None:
        self.num_envs = num_envs
        self.rng = np.random.default_rng(seed)
        self.physics = self.physics_type(num_envs, timestep, self.rng, threads, pool, feet_only)
        self.cost_scale = 1.0
        self.reward_scale: dict[str, float] = {}
        self.push_speed = 1.0
        self.command_period = 3.0  # mean time between commands in [s]
        self.still_share = 0.15  # of commands are exactly zero
        self.command_share = 1.0  # of the command ranges
        self.idle_steps = IDLE_STEPS
        n = num_envs
        self.command = np.zeros((n, 3), np.float32)
        self.actions = np.zeros((3, n, 12), np.float32)  # this, last, the one before
        self.target = np.tile(contract.DEFAULT_JOINT_POS, (n, 1)).astype(np.float64)
        self.delay = np.zeros(n, np.int64)  # physics steps until a new target arrives
        self.encoder_offset = np.zeros((n, 12))
        self.air_time = np.zeros((n, 4))
        self.contact = np.ones((n, 4), bool)
        self.joint_vel = np.zeros((n, 12))
        self.steps = np.zeros(n, np.int64)
        self.idle = np.zeros(n, np.int64)
        # Error of vx, vy [m/s] and wz [rad/s], averaged over `BIAS_TIME`.
        self.bias = np.zeros((n, 3))
        self.force = np.zeros((n, 4))
        self.foot_z = np.zeros((n, 4))
        self.stats: dict[str, list[float]] = {}
        self._reset(np.arange(n))
        self.steps[:] = self.rng.integers(0, self.episode_steps, n)

    def _reset(self, ids: np.ndarray) -> None:
        n, rng = len(ids), self.rng
        qpos = np.zeros((n, 19))
        yaw = rng.uniform(-np.pi, np.pi, n)
        tilt = rng.uniform(-0.05, 0.05, (n, 2))
        qpos[:, 2] = rng.uniform(0.3, 0.34, n)
        qpos[:, 3] = np.cos(yaw / 2)
        qpos[:, 6] = np.sin(yaw / 2)
        qpos[:, 4:6] = tilt
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        qpos[:, 7:] = contract.DEFAULT_JOINT_POS + rng.uniform(-0.2, 0.2, (n, 12))
        qvel = np.zeros((n, 18))
        qvel[:, :6] = rng.uniform(-0.4, 0.4, (n, 6))
        self.physics.state[ids, 0] = 0.0
        self.physics.state[ids, QPOS] = qpos
        self.physics.state[ids, QVEL] = qvel
        self.actions[:, ids] = 0.0
        self.target[ids] = contract.DEFAULT_JOINT_POS
        self.delay[ids] = rng.integers(0, self.physics.decimation + 1, n)
        self.encoder_offset[ids] = rng.uniform(-0.02, 0.02, (n, 12))
        self.air_time[ids] = 0.0
        self.contact[ids] = True
        self.joint_vel[ids] = 0.0
        self.steps[ids] = 0
        self.idle[ids] = 0
        self.bias[ids] = 0.0
        self._sample_command(ids)

    def _sample_command(self, ids: np.ndarray) -> None:
        n, rng = len(ids), self.rng
        command = rng.uniform(COMMAND_LOW, COMMAND_HIGH, (n, 3))
        # The gait is harder to learn backwards: half of the commands go there, not a third.
        flipped = (command[:, 0] > 0) & (rng.random(n) < 0.2)
        command *= self.command_share
        command[flipped, 0] *= COMMAND_LOW[0] / COMMAND_HIGH[0]
        kind = rng.random(n)
        # A third goes straight: along, sideways, turning, and diagonally without turning.
        command[kind > 0.88] *= (1.0, 0.0, 0.0)
        command[(kind > 0.79) & (kind < 0.88)] *= (0.0, 1.0, 0.0)
        command[(kind > 0.71) & (kind < 0.79)] *= (0.0, 0.0, 1.0)
        command[(kind > 0.65) & (kind < 0.71)] *= (1.0, 1.0, 0.0)
        command[kind < self.still_share] = 0.0
        self.command[ids] = command

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Advance one policy step. Returns observation, critic observation, reward, done, timeout.

        Observations of finished episodes are those of the new one.
        """
        physics, rng = self.physics, self.rng
        self.actions[2], self.actions[1] = self.actions[1], self.actions[0]
        self.actions[0] = action
        clipped = np.clip(action, -contract.ACTION_CLIP, contract.ACTION_CLIP)
        target = contract.DEFAULT_JOINT_POS + contract.ACTION_SCALE * clipped
        late = np.arange(physics.decimation)[None, :, None] < self.delay[:, None, None]
        targets = np.where(late, self.target[:, None], target[:, None])
        self.target[:] = target
        physics.step(targets)
        broken = ~np.isfinite(physics.state).all(axis=1)
        physics.state[broken] = 0.0
        reward = self._reward()
        self.steps += 1
        gravity, height = self.gravity, self.height
        fallen = (height < 0.17) | (gravity[:, 2] > -0.6) | broken
        stepping = (self.air_time > 0.07).any(axis=1)  # a twitch is not a step
        waiting = ~stepping & (np.abs(self.command).max(axis=1) > 0.15)
        self.idle = np.where(waiting, self.idle + 1, 0)
        failed = fallen | (self.idle >= self.idle_steps)
        timeout = (self.steps >= self.episode_steps) & ~failed
        done = failed | timeout
        reward = np.where(failed, reward - 1.0, reward)
        self._log("fall_rate", fallen.mean())
        self._log("idle_rate", (failed & ~fallen).mean())
        resample = rng.random(self.num_envs) < contract.PERIOD / self.command_period
        self._sample_command(np.flatnonzero(resample))
        if self.push_speed > 0:
            pushed = np.flatnonzero(rng.random(self.num_envs) < contract.PERIOD / 5.0)
            kick = rng.uniform(-1, 1, (len(pushed), 6)) * self.push_speed
            kick[:, 2] *= 0.3
            physics.state[pushed, 20:26] += kick
        if done.any():
            self._reset(np.flatnonzero(done))
        observation, critic = self.observe()
        return observation, critic, reward.astype(np.float32), done, timeout

    def _measure(self) -> None:
        state = self.physics.state
        quat = state[:, 4:8]
        self.height = state[:, 3]
        self.gravity = rotate_inverse(quat, np.tile([0.0, 0.0, -1.0], (self.num_envs, 1)))
        self.yaw = np.arctan2(
            2 * (quat[:, 0] * quat[:, 3] + quat[:, 1] * quat[:, 2]),
            1 - 2 * (quat[:, 2] ** 2 + quat[:, 3] ** 2),
        )
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        vel = state[:, 20:23]
        self.lin_vel = np.stack(
            [cos * vel[:, 0] + sin * vel[:, 1], cos * vel[:, 1] - sin * vel[:, 0], vel[:, 2]], 1
        )
        self.ang_vel = state[:, 23:26]

    def _reward(self) -> np.ndarray:
        physics = self.physics
        self._measure()
        contact = physics.foot_force > 1.0
        touchdown = contact & ~self.contact
        self.air_time += contract.PERIOD
        joint_vel = physics.state[:, 26:38]
        planar = np.concatenate([self.lin_vel[:, :2], self.ang_vel[:, 2:]], axis=1)
        self.bias += (self.command - planar - self.bias) * (contract.PERIOD / BIAS_TIME)
        tick = Tick(
            self.command,
            self.lin_vel,
            self.ang_vel,
            self.bias,
            self.gravity,
            self.height,
            physics.state[:, 8:20],
            joint_vel,
            self.joint_vel,
            physics.torque,
            (self.actions[0], self.actions[1], self.actions[2]),
            contact,
            touchdown,
            physics.foot_force,
            self.air_time,
            physics.foot_pos,
            physics.foot_vel,
        )
        total = np.zeros(self.num_envs)
        for name, (weight, value) in reward_terms(tick).items():
            term = weight * self.reward_scale.get(name, 1.0) * value
            term *= self.cost_scale if weight < 0 else 1.0
            total += np.clip(term, -6.0, 6.0)
            self._log(name, term.mean())
        moving = np.abs(self.command).max(axis=1) > 0.05
        error = np.linalg.norm(self.command[:, :2] - self.lin_vel[:, :2], axis=1)
        self._log("error_lin", error.mean())
        self._log("error_ang", np.abs(self.command[:, 2] - self.ang_vel[:, 2]).mean())
        moved = moving[:, None] & touchdown
        self._log("bias_lin", np.linalg.norm(self.bias[:, :2], axis=1).mean())
        self._log("bias_ang", np.abs(self.bias[:, 2]).mean())
        self._log("touchdown_force", physics.foot_force[moved].sum() + 1e-9)
        self._log("swing_time", self.air_time[moved].sum() + 1e-9)
        self._log("swings", moved.sum() + 1e-9)
        self.air_time[contact] = 0.0
        self.contact = contact
        self.joint_vel = joint_vel.copy()
        self.force = physics.foot_force
        self.foot_z = physics.foot_pos[:, :, 2]
        return total * contract.PERIOD * 2.0

    def observe(self) -> tuple[np.ndarray, np.ndarray]:
        """Noisy observation (num_envs, 45) and noise-free critic observation (num_envs, 60)."""
        self._measure()
        state = self.physics.state
        raw = np.concatenate(
            [
                self.ang_vel,
                self.gravity,
                self.command,
                state[:, 8:20] - contract.DEFAULT_JOINT_POS,
                state[:, 26:38],
                self.actions[0],
            ],
            axis=1,
        )
        noisy = raw + NOISE * self.rng.uniform(-1, 1, raw.shape)
        noisy[:, 9:21] += self.encoder_offset
        critic = np.concatenate(
            [
                raw * contract.OBS_SCALE,
                2.0 * self.lin_vel,
                5.0 * (self.height[:, None] - 0.29),
                np.minimum(self.force / 60.0, 3.0),
                10.0 * (self.foot_z - 0.02),
                4.0 * self.bias,
            ],
            axis=1,
        )
        return (noisy * contract.OBS_SCALE).astype(np.float32), critic.astype(np.float32)

    def _log(self, name: str, value: float) -> None:
        self.stats.setdefault(name, []).append(float(value))

    def pop_stats(self) -> dict[str, float]:
        """Means since the last call; per swing: `swing_time` in [s], `touchdown_force` in [N]."""
        stats = {name: float(np.mean(values)) for name, values in self.stats.items()}
        swings = stats.pop("swings")
        stats["swing_time"] /= swings
        stats["touchdown_force"] /= swings
        self.stats.clear()
        return stats
