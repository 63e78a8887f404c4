"""A scripted trot that teaches the untrained network to step, for `train.py`.

From white exploration noise alone, PPO on two cores first learns to shuffle on four feet. So the
actor starts as a copy of this simple gait: a clock, straight stance, sine swing, inverse
kinematics, some feedback of speed and tilt; it tracks speed within 0.24 m/s. Clock and true speed
stay here: the network only ever sees its own measurable observation, and PPO then replaces the
gait by its own.
"""

from __future__ import annotations

import contract
import numpy as np
import torch
from env import Go2Env
from ppo import ActorCritic

LINK = 0.213  # thigh and calf length in [m]
HIP = np.array([-1.0, 1.0, -1.0, 1.0]) * 0.0955  # hip to thigh joint, sideways in [m]
HIP_POS = np.array([[0.1934, -0.0465], [0.1934, 0.0465], [-0.1934, -0.0465], [-0.1934, 0.0465]])
PHASE_OFFSET = np.array([0.0, 0.5, 0.5, 0.0])  # diagonal pairs
FREQUENCY = 2.5  # strides per second
START = 0.1  # phase of the first step: lifts at once, always the same diagonal
LIFT = 0.1  # [m] of target; the soft PD reaches about two thirds
PUSH = 0.02  # [m] that stance feet press below the stance height
SPEED_GAIN = 0.2  # feet lead a base that is too fast, per speed error in [s]
LEVEL, LEVEL_RATE = 0.2, 0.03  # stance leg extension per tilt [1], per tilt rate in [s]


def leg_positions(joint_pos: np.ndarray) -> np.ndarray:
    """Feet in the hip frames in [m], shape (n, 4, 3), of joint positions (n, 12) in [rad]."""
    hip, thigh, calf = joint_pos.reshape(-1, 4, 3).transpose(2, 0, 1)
    x = -LINK * (np.sin(thigh) + np.sin(thigh + calf))
    down = LINK * (np.cos(thigh) + np.cos(thigh + calf))
    y = HIP * np.cos(hip) + down * np.sin(hip)
    z = HIP * np.sin(hip) - down * np.cos(hip)
    return np.stack([x, y, z], axis=2)


def leg_angles(feet: np.ndarray) -> np.ndarray:
    """Joint positions (n, 12) in [rad] that put the feet at (n, 4, 3) in the hip frames."""
    x, y, z = feet.transpose(2, 0, 1)
    down = np.sqrt(np.maximum(y**2 + z**2 - HIP**2, 0.1**2))
    hip = np.arctan2(z, y) - np.arctan2(-down, HIP)
    hip = (hip + np.pi) % (2 * np.pi) - np.pi
    reach = np.clip((x**2 + down**2) / (2 * LINK**2) - 1.0, -0.92, 0.65)
    calf = -np.arccos(reach)
    thigh = np.arctan2(-x, down) - np.arctan2(np.sin(calf), 1.0 + np.cos(calf))
    return np.stack([hip, thigh, calf], axis=2).reshape(len(x), 12)


class Trot:
    """Clocked trot of all environments; actions in the policy's units."""

    def __init__(self, env: Go2Env) -> None:
        self.env = env
        self.phase = np.zeros(env.num_envs)
        self.stance = leg_positions(contract.DEFAULT_JOINT_POS[None].astype(float))

    def action(self) -> np.ndarray:
        """The gait's next action, shape (num_envs, 12)."""
        env = self.env
        moving = np.abs(env.command).max(axis=1) > 0.05
        ahead = self.phase + FREQUENCY * contract.PERIOD
        self.phase = np.where(moving & (env.steps > 0), ahead, START)
        phase = (self.phase[:, None] + PHASE_OFFSET) % 1.0
        swing = phase < 0.5
        progress = (phase % 0.5) * 2.0
        reach = HIP_POS + self.stance[0, :, :2]
        vx, vy, wz = env.command.T[:, :, None]
        speed = np.stack([vx - wz * reach[:, 1], vy + wz * reach[:, 0]], axis=2)
        half = speed * 0.25 / FREQUENCY
        along = np.where(swing, -np.cos(np.pi * progress), 1.0 - 2.0 * progress)
        error = env.lin_vel[:, None, :2] - np.stack([vx, vy], axis=2)
        feet = np.tile(self.stance, (env.num_envs, 1, 1))
        feet[:, :, :2] += half * along[:, :, None] + SPEED_GAIN * error
        feet[:, :, 2] += np.where(swing, LIFT * np.sin(np.pi * progress), -PUSH)
        tilt = reach[:, 0] * env.gravity[:, :1] + reach[:, 1] * env.gravity[:, 1:2]
        rate = reach[:, 1] * env.ang_vel[:, :1] - reach[:, 0] * env.ang_vel[:, 1:2]
        feet[:, :, 2] += np.where(swing, 0.0, LEVEL_RATE * rate - LEVEL * tilt)
        angles = np.where(moving[:, None], leg_angles(feet), contract.DEFAULT_JOINT_POS)
        return ((angles - contract.DEFAULT_JOINT_POS) / contract.ACTION_SCALE).astype(np.float32)


def teach(env: Go2Env, net: ActorCritic, steps: int = 600, epochs: int = 10) -> float:
    """Clone the trot into the actor; returns the final mean squared error.

    The executed action carries noise while the label does not, so the copy learns to come back.
    """
    trot = Trot(env)
    obs, _ = env.observe()
    observations, labels = [], []
    usual = env.command_period, env.still_share
    env.command_period, env.still_share = 1.0, 0.3  # many starts and stops
    for _ in range(steps):
        label = trot.action()
        observations.append(torch.from_numpy(obs))
        labels.append(torch.from_numpy(label))
        noise = 0.25 * env.rng.standard_normal(label.shape).astype(np.float32)
        obs, _, _, _, _ = env.step(label + noise)
    env.command_period, env.still_share = usual
    x, y = torch.cat(observations), torch.cat(labels)
    return imitate(net.actor, x, y, 1e-3, epochs)


def imitate(
    actor: torch.nn.Module, x: torch.Tensor, y: torch.Tensor, rate: float, epochs: int
) -> float:
    """Regress the actor on (x, y), the rate falling; returns the last mean squared error."""
    optimizer = torch.optim.Adam(actor.parameters(), lr=rate)
    total = 0.0
    for epoch in range(epochs):
        for group in optimizer.param_groups:
            group["lr"] = rate * (1.0 - epoch / epochs)
        losses = []
        for rows in torch.randperm(len(x)).split(4096):
            loss = torch.nn.functional.mse_loss(actor(x[rows]), y[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        total = float(np.mean(losses))
    return total
