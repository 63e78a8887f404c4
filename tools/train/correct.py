"""Teach a network that walks to walk as fast as it is told, for `train.py --refine`.

A network told -0.9 m/s may go back at -0.6: slow, but told well. So a frozen copy is told more than
was asked for, by the integral of its true speed error, until its mean speed is right; the network
then learns from that copy what to do under the plain command. True speed stays here: the network
only ever sees its own measurable observation.
"""

from __future__ import annotations

import copy

import contract
import numpy as np
import torch
from env import Go2Env
from ppo import ActorCritic
from warmstart import imitate

GAIN = 1.2  # of the integral in [1/s]: it settles within two seconds, a stride takes half of one
LARGEST = np.array([0.7, 0.4, 0.6])  # correction in [m/s], [m/s], [rad/s]
STARTED, SETTLED = 50, 150  # ticks after which the integral runs, and counts as found
NUM_FEATURES = 13


def features(command: np.ndarray) -> np.ndarray:
    """Both halves of each axis, products, and whether to move, shape (n, 13); commands (n, 3)."""
    x, y, w = command.T
    halves = [np.maximum(sign * v, 0.0) for v in (x, y, w) for sign in (1, -1)]
    products = [x * y, y * w, w * x, x * np.abs(y), x * np.abs(w), y * np.abs(w)]
    moving = np.abs(command).max(axis=1) > 0.05
    return np.stack([*halves, *products, moving.astype(float)], axis=1)


class Correction:
    """What to tell the network so that it does what was asked: a fit plus each robot's integral.

    Attributes:
        fit: correction as a linear function of `features`, shape (13, 3).
    """

    def __init__(self, env: Go2Env) -> None:
        self.env = env
        self.fit = np.zeros((NUM_FEATURES, 3))
        self.integral = np.zeros((env.num_envs, 3))
        self.since = np.zeros(env.num_envs, np.int64)
        self.last = env.command.copy()
        self.seen: list[np.ndarray] = []
        self.found: list[np.ndarray] = []

    def told(self) -> np.ndarray:
        """The corrected commands of this tick, shape (num_envs, 3)."""
        env = self.env
        same = (env.command == self.last).all(axis=1) & (env.steps > 0)
        self.last = env.command.copy()
        self.since = np.where(same, self.since + 1, 0)
        self.integral[~same] = 0.0
        known = features(env.command)
        moving = known[:, -1:] > 0
        # Earlier, the lag of the start would count as slowness: a network taught so went 15 % fast.
        ready = moving & (self.since > STARTED)[:, None]
        self.integral += np.where(ready, GAIN * contract.PERIOD * env.bias, 0.0)
        self.integral = np.clip(self.integral, -LARGEST, LARGEST)
        correction = np.clip(known @ self.fit + self.integral, -LARGEST, LARGEST)
        settled = self.since > SETTLED
        self.seen.append(known[settled])
        self.found.append(correction[settled])
        return np.asarray(env.command + np.where(moving, correction, 0.0))

    def learn(self) -> None:
        """Fit what was found, so that a new command begins with the right correction."""
        seen, found = np.concatenate(self.seen), np.concatenate(self.found)
        normal = seen.T @ seen + 1e-5 * len(seen) * np.eye(NUM_FEATURES)
        self.fit = np.linalg.solve(normal, seen.T @ found)
        self.seen.clear()
        self.found.clear()


@torch.no_grad()
def drive(
    env: Go2Env, teacher: torch.nn.Module, correction: Correction, steps: int, noise: float
) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Let the corrected network walk; returns plain observations and its actions, one per step."""
    plain, labels = [], []
    scale = contract.OBS_SCALE[6:9]
    obs, _ = env.observe()
    for _ in range(steps):
        told = obs.copy()
        told[:, 6:9] = correction.told() * scale
        label = teacher(torch.from_numpy(told))
        plain.append(torch.from_numpy(obs.copy()))
        labels.append(label)
        random = noise * env.rng.standard_normal(label.shape).astype(np.float32)
        obs, _, _, _, _ = env.step(label.numpy() + random)
    return plain, labels


def correct(
    env: Go2Env, net: ActorCritic, noise: float = 0.12, rounds: int = 3, steps: int = 350
) -> float:
    """Correct the actor in place; returns the final mean squared error.

    `noise`, in action units, shows the network what surrounds the gait, and how to come back.
    """
    teacher = copy.deepcopy(net.actor)
    correction = Correction(env)
    env.command_period, env.push_speed, env.command_share = 5.0, 0.3, 0.9
    drive(env, teacher, correction, 300, noise)
    correction.learn()
    observations, labels = [], []
    for _ in range(rounds):
        plain, label = drive(env, teacher, correction, steps, noise)
        correction.learn()
        observations += plain
        labels += label
    env.command_share = 1.0
    return imitate(net.actor, torch.cat(observations), torch.cat(labels), 5e-4, 12)
