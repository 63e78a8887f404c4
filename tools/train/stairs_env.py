"""The Go2 task on steps, seen through a height scan, for `train.py --stairs`."""

from __future__ import annotations

import contract
import numpy as np
from env import NUM_CRITIC, Go2Env
from integral import NUM_MEMORY, Tell, keep_past
from terrain import CLIMBS, HALF, RISES, TerrainPhysics

FLAT_SHARE = 0.15  # of the robots stay on flat ground, with the commands of the flat task
START_LEVELS = (4, 12)
HOLD = 1.0  # of a heading in [1/s], as who drives it up stairs would
# Half widths of the scan's errors: each point, and per episode the whole of it, up and sideways.
POINT, OFFSET, DRIFT = 0.02, 0.03, 0.04  # [m]
HOLES = 0.05  # most of an episode's share of points without a measurement
DELAY = 2  # most, in ticks
# What a step needs that flat ground does not: to pitch, to heave, to lift and to push.
REWARD_SCALE = {
    "orientation": 0.4,
    "lin_vel_z": 0.3,
    "ang_vel_xy": 0.5,
    "height": 0.5,
    "torque_peak": 0.4,
    "torque_over": 0.1,
    "joint_acc": 0.5,
    "impact": 0.5,
    "trot": 0.7,
    "clearance": 4.0,
    "track_lin_fine": 0.5,
    "lin_bias": 0.6,
    "pose": 0.3,
    "track_ang": 2.0,
    "track_ang_fine": 1.5,
    "error_ang_abs": 1.5,
    "yaw_bias": 2.5,
    "still_pose": 2.0,
    "still_vel": 5.0,
    "still_feet": 5.0,
}
LIFT = 1.5  # reward of a foot that is lifted before a step
STUMBLE = -0.5  # of a foot that touches what it does not stand on
_BELOW = np.flatnonzero((np.abs(contract.SCAN) < 0.21).all(axis=1))  # of the scan: the trunk's
_AROUND = 0.08 * np.array([[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)])


class StairsEnv(Go2Env):
    """`Go2Env` on the grounds of `terrain.py`: who walks as asked goes on to higher steps.

    `tell` is the integral of the blind network, which stays as it is; none until it is set.
    """

    physics_type = TerrainPhysics
    episode_steps = 350
    num_obs = contract.NUM_OBS + len(contract.SCAN)
    num_critic = NUM_CRITIC + len(contract.SCAN)

    def __init__(self, num_envs: int, *args: int, **options: int) -> None:
        n = num_envs
        self.flat = np.arange(n) < FLAT_SHARE * n
        self.asked, self.went = np.zeros(n), np.zeros(n)
        self.scan_offset = np.zeros((n, 1))
        self.scan_drift = np.zeros((n, 1, 2))
        self.scan_holes = np.zeros((n, 1))
        self.scan_delay = np.zeros(n, np.int64)
        self.scans = np.zeros((DELAY + 1, n, len(contract.SCAN)))  # the newest first
        self.fresh = np.ones(n, bool)
        self.memory = np.zeros((n, NUM_MEMORY), np.float32)
        self.heading = np.full(n, np.nan)  # to be held in [rad], NaN for none
        self.tell: Tell = keep_past
        super().__init__(n, *args, **options)
        self.reward_scale = REWARD_SCALE
        self.still_share = 0.4
        self.physics.level[:] = self.rng.integers(*START_LEVELS, n)
        self._reset(np.arange(n))
        self.steps[:] = self.rng.integers(0, self.episode_steps, n)
        self._measure()

    def _reset(self, ids: np.ndarray) -> None:
        physics, rng = self.physics, self.rng
        ratio = self.went[ids] / np.maximum(self.asked[ids], 1e-6)
        known = (self.asked[ids] > 0.5) & ~self.flat[ids] & np.isin(physics.kind[ids], CLIMBS)
        self._log("terrain_ratio", ratio[known].mean() if known.any() else 1.0)
        fell = self.steps[ids] < self.episode_steps
        level = physics.level[ids] + (known & ~fell & (ratio > 0.75))
        level -= known & (fell | (ratio < 0.45))
        random = rng.integers(4, len(RISES), len(ids))
        level = np.where(level >= len(RISES), random, np.maximum(level, 1))
        level[self.flat[ids]] = 0
        physics.move(ids, level, rng)
        super()._reset(ids)
        self.asked[ids], self.went[ids] = 0.0, 0.0
        # Half of the robots start anywhere, the others before the first step and look along it.
        anywhere = rng.random(len(ids)) < 0.5
        pos = np.where(anywhere[:, None], rng.uniform(-1, 1, (len(ids), 2)) * (HALF - 2.0), 0.0)
        under = physics.ground(pos[:, None] + 2.5 * _AROUND, ids).max(axis=1)
        yaw = np.where(anywhere, rng.integers(0, 2, len(ids)) * np.pi, 0.0)
        self.heading[ids] = np.where(np.isnan(self.heading[ids]), np.nan, yaw)
        yaw += rng.uniform(-0.6, 0.6, len(ids))
        state = physics.state
        stepped = ids[~self.flat[ids]]
        chosen = ~self.flat[ids]
        state[stepped, 1:3] = pos[chosen]
        state[stepped, 3] += under[chosen]
        state[stepped, 4:8] = 0.0
        state[stepped, 4], state[stepped, 7] = np.cos(yaw / 2)[chosen], np.sin(yaw / 2)[chosen]
        self.scan_offset[ids, 0] = rng.uniform(-OFFSET, OFFSET, len(ids))
        self.scan_drift[ids, 0] = rng.uniform(-DRIFT, DRIFT, (len(ids), 2))
        self.scan_holes[ids, 0] = rng.uniform(-HOLES, HOLES, len(ids))
        self.scan_delay[ids] = rng.integers(0, DELAY + 1, len(ids))
        self.fresh[ids] = True

    def _sample_command(self, ids: np.ndarray) -> None:
        super()._sample_command(ids)
        rng = self.rng
        along = ids[~self.flat[ids] & (rng.random(len(ids)) < 0.75)]
        command = np.zeros((len(along), 3))
        command[:, 0] = rng.uniform(0.3, 0.7, len(along))
        command[:, 2] = rng.uniform(-0.4, 0.4, len(along)) * (rng.random(len(along)) < 0.3)
        self.command[along] = command
        self.heading[ids] = np.nan
        held = along[(command[:, 2] == 0.0) & (rng.random(len(along)) < 0.6)]
        quat = self.physics.state[held, 4:8]
        self.heading[held] = 2.0 * np.arctan2(quat[:, 3], quat[:, 0])

    def _measure(self) -> None:
        super()._measure()
        state = self.physics.state
        cos, sin = np.cos(self.yaw)[:, None], np.sin(self.yaw)[:, None]
        x, y = contract.SCAN.T
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        self.points = state[:, None, 1:3] + turned
        self.scan = state[:, 3:4] - self.physics.ground(self.points)
        self.height = self.scan[:, _BELOW].mean(axis=1)

    def _reward(self) -> np.ndarray:
        # Feet count above the highest ground near them, so that they have to clear the next step.
        feet = self.physics.foot_pos
        near = feet[:, :, None, :2] + _AROUND
        ground = self.physics.ground(near.reshape(self.num_envs, -1, 2))
        ground = ground.reshape(self.num_envs, 4, -1)
        above, top = feet[:, :, 2] - ground[:, :, 4], ground.max(axis=2)
        rise = top - ground[:, :, 4]
        feet[:, :, 2] -= top
        # A stubbed foot does not move, so that the cost of clearance says nothing to it.
        before = (rise > 0.02) & (np.abs(self.command).max(axis=1) > 0.05)[:, None]
        lifted = np.clip((above - 0.025) / (rise + 0.04), 0.0, 1.0) * (self.air_time < 0.4)
        stumbled = (above > 0.035) & (self.physics.foot_force > 5.0)
        extra = LIFT * (before * lifted).sum(axis=1) + STUMBLE * (before * stumbled).sum(axis=1)
        self._log("lift", (before * lifted).sum() / max(before.sum(), 1))
        self._log("stumble", (before * stumbled).sum() / max(before.sum(), 1))
        total = super()._reward() + extra * contract.PERIOD * 2.0
        asked = self.command[:, :2] * contract.PERIOD
        self.asked += (asked * self.command[:, :2]).sum(axis=1)
        self.went += (asked * self.lin_vel[:, :2]).sum(axis=1)
        return total

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        held = np.isfinite(self.heading)
        off = (self.heading[held] - self.yaw[held] + np.pi) % (2.0 * np.pi) - np.pi
        self.command[held, 2] = np.clip(HOLD * off, -0.6, 0.6)
        outside = (np.abs(self.physics.state[:, 1:3]) > HALF - 0.9).any(axis=1) & ~self.flat
        self.steps[outside] = self.episode_steps
        self._log("level", self.physics.level[~self.flat].mean())
        return super().step(action)

    def observe(self) -> tuple[np.ndarray, np.ndarray]:
        """Noisy observation (num_envs, 232), noise-free critic observation (num_envs, 247)."""
        felt, critic = super().observe()
        rng = self.rng
        self.memory[self.fresh] = 0.0
        observation, self.memory = self.tell(felt, self.memory)
        seen = self.physics.state[:, 3:4] - self.physics.ground(self.points + self.scan_drift)
        seen += self.scan_offset + POINT * rng.uniform(-1, 1, seen.shape)
        seen[rng.random(seen.shape) < self.scan_holes] = contract.SCAN_HEIGHT
        self.scans = np.roll(self.scans, 1, axis=0)
        self.scans[0] = seen
        self.scans[:, self.fresh] = seen[self.fresh]
        self.fresh[:] = False
        late = self.scans[self.scan_delay, np.arange(self.num_envs)]
        return (
            np.concatenate([observation, contract.scaled_scan(late)], axis=1).astype(np.float32),
            np.concatenate([critic, contract.scaled_scan(self.scan)], axis=1).astype(np.float32),
        )
