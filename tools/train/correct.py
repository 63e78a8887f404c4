"""Teach a network that walks to walk as fast as it is told, for `train.py --correct`.

A trot told -0.9 m/s may go back at -0.6: slow, but told well. So a copy of the network is told more
than was asked for, by the integral of its true speed error, until its mean speed is right; the
network then learns from it what to do when it is told the plain command. True speed stays here:
the network only ever sees its own measurable observation.
"""

from __future__ import annotations

import contract
import numpy as np
import torch
from env import Go2Env
from ppo import ActorCritic

GAIN = 1.2  # of the integral in [1/s]: it settles within two seconds, a stride takes half of one
LARGEST = np.array([0.7, 0.4, 0.6])  # correction in [m/s], [m/s], [rad/s]
SETTLED = 100  # ticks after which the correction counts as found
NOISE = 0.12  # action units: the network sees what surrounds the gait, and how to come back


def features(command: np.ndarray) -> np.ndarray:
    """Commands (n, 3) as (n, 13): both halves of each axis, products, one."""
    x, y, w = command.T
    halves = [np.maximum(s * v, 0.0) for v in (x, y, w) for s in (1, -1)]
    products = [x * y, y * w, w * x, x * abs(y), x * abs(w), y * abs(w)]
    moving = (np.abs(command).max(axis=1) > 0.05).astype(float)
    return np.stack([*halves, *products, moving], axis=1)


class Correction:
    """What to tell the network so that it does what was asked: a fit plus each robot's integral.

    Attributes:
        fit: correction as a linear function of `features`, shape (13, 3).
    """

    def __init__(self, env: Go2Env) -> None:
        self.env = env
        self.fit = np.zeros((13, 3))
        self.integral = np.zeros((env.num_envs, 3))
        self.since = np.zeros(env.num_envs, np.int64)
        self.last = env.command.copy()
        self.seen: list[np.ndarray] = []
        self.found: list[np.ndarray] = []

    def __call__(self) -> np.ndarray:
        """The corrected commands of this tick, shape (num_envs, 3)."""
        env = self.env
        same = (env.command == self.last).all(axis=1) & (env.steps > 0)
        self.last = env.command.copy()
        self.since = np.where(same, self.since + 1, 0)
        self.integral[~same] = 0.0
        moving = (np.abs(env.command).max(axis=1) > 0.05)[:, None]
        ready = (self.since > 25)[:, None]  # the averaged error still holds the last command's
        self.integral += np.where(moving & ready, GAIN * contract.PERIOD * env.bias, 0.0)
        self.integral = np.clip(self.integral, -LARGEST, LARGEST)
        known = features(env.command)
        correction = np.clip(known @ self.fit + self.integral, -LARGEST, LARGEST)
        settled = self.since > SETTLED
        self.seen.append(known[settled])
        self.found.append(correction[settled])
        return env.command + np.where(moving, correction, 0.0)

    def learn(self) -> None:
        """Fit what was found, so that a new command begins with the right correction."""
        seen, found = np.concatenate(self.seen), np.concatenate(self.found)
        normal = seen.T @ seen + 1e-3 * len(seen) * np.eye(13) * 0.01
        self.fit = np.linalg.solve(normal, seen.T @ found)
        self.seen.clear()
        self.found.clear()


@torch.no_grad()
def drive(
    env: Go2Env, teacher: torch.nn.Module, correction: Correction, steps: int, keep: bool
) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Let the corrected network walk; returns plain observations and its actions."""
    plain, labels = [], []
    scale = contract.OBS_SCALE[6:9]
    obs, _ = env.observe()
    for _ in range(steps):
        told = obs.copy()
        told[:, 6:9] = correction() * scale
        label = teacher(torch.from_numpy(told))
        if keep:
            plain.append(torch.from_numpy(obs.copy()))
            labels.append(label)
        noise = NOISE * env.rng.standard_normal(label.shape).astype(np.float32)
        obs, _, _, _, _ = env.step(label.numpy() + noise)
    return plain, labels


def correct(env: Go2Env, net: ActorCritic, rounds: int = 3, steps: int = 350) -> None:
    """Correct the actor in place."""
    import copy

    teacher = copy.deepcopy(net.actor)
    correction = Correction(env)
    env.command_period, env.push_speed = 4.0, 0.3
    drive(env, teacher, correction, 200, False)
    correction.learn()
    observations, labels = [], []
    for r in range(rounds):
        env.pop_stats() if env.stats else None
        x, y = drive(env, teacher, correction, steps, True)
        stats = env.pop_stats()
        print("corrected", {k: round(stats[k], 4) for k in ("error_lin", "error_ang", "bias_lin", "bias_ang", "fall_rate", "idle_rate")}, flush=True)
        correction.learn()
        print(np.round(correction.fit.T, 2), flush=True)
        observations += x
        labels += y
    loss = fit(net.actor, torch.cat(observations), torch.cat(labels), 12)
    print("loss", loss, flush=True)


def fit(actor: torch.nn.Module, x: torch.Tensor, y: torch.Tensor, epochs: int) -> float:
    """Regress the actor on (x, y); returns the last epoch's mean squared error."""
    optimizer = torch.optim.Adam(actor.parameters(), lr=5e-4)
    total = 0.0
    for epoch in range(epochs):
        for group in optimizer.param_groups:
            group["lr"] = 5e-4 * (1.0 - epoch / epochs) + 1e-5
        losses = []
        for rows in torch.randperm(len(x)).split(4096):
            loss = torch.nn.functional.mse_loss(actor(x[rows]), y[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        total = float(np.mean(losses))
        print(epoch, round(total, 5), flush=True)
    return total
