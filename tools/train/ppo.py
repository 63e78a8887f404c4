"""PPO with an asymmetric critic, for `train.py`.

Proximal policy optimisation: Schulman et al. 2017 (arXiv 1707.06347), with generalised advantage
estimation (arXiv 1506.02438) and the learning rate steered by the measured KL divergence.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

SPEED = slice(45, 48)  # of the critic's observation: the base velocity, times two


def mlp(sizes: list[int], last_gain: float) -> nn.Sequential:
    """Fully connected ELU network with orthogonal weights."""
    layers: list[nn.Module] = []
    for i, (a, b) in enumerate(itertools.pairwise(sizes)):
        linear = nn.Linear(a, b)
        last = i == len(sizes) - 2
        nn.init.orthogonal_(linear.weight, last_gain if last else 2**0.5)
        nn.init.zeros_(linear.bias)
        layers += [linear] if last else [linear, nn.ELU()]
    return nn.Sequential(*layers)


class ActorCritic(nn.Module):
    """Gaussian actor on the observation, value on the critic's observation.

    `speed` reads the base velocity from the actor's last hidden layer. It only exists in training,
    so that this layer holds what stance legs tell of it (after Ji et al. 2022, arXiv 2202.05481).
    """

    def __init__(self, num_obs: int, num_critic: int, num_actions: int, std: float = 0.25) -> None:
        super().__init__()
        self.actor = mlp([num_obs, 256, 128, 64, num_actions], 0.01)
        self.critic = mlp([num_critic, 256, 128, 64, 1], 1.0)
        self.speed = nn.Linear(64, 3)
        self.log_std = nn.Parameter(torch.full((num_actions,), float(np.log(std))))

    def distribution(self, obs: torch.Tensor) -> torch.distributions.Normal:
        return self.around(self.actor(obs))

    def around(self, mean: torch.Tensor) -> torch.distributions.Normal:
        return torch.distributions.Normal(mean, self.log_std.exp().expand_as(mean), False)


@dataclass
class Batch:
    """One rollout, flattened: rows are samples."""

    obs: torch.Tensor
    critic: torch.Tensor
    action: torch.Tensor
    log_prob: torch.Tensor
    mean: torch.Tensor
    value: torch.Tensor
    target: torch.Tensor  # value target
    advantage: torch.Tensor


@dataclass
class Settings:
    """PPO's numbers."""

    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    epochs: int = 4
    minibatches: int = 4
    entropy: float = 0.0  # the warm start explores enough; noise only costs at stiff gains
    desired_kl: float = 0.015
    max_grad: float = 1.0
    min_rate: float = 2e-5
    max_rate: float = 1e-3


def advantages(
    reward: torch.Tensor,
    done: torch.Tensor,
    value: torch.Tensor,
    last_value: torch.Tensor,
    settings: Settings,
) -> torch.Tensor:
    """Generalised advantage estimates; inputs of shape (steps, num_envs)."""
    result = torch.zeros_like(reward)
    running = torch.zeros_like(last_value)
    for t in reversed(range(len(reward))):
        alive = 1.0 - done[t]
        following = last_value if t == len(reward) - 1 else value[t + 1]
        delta = reward[t] + settings.gamma * alive * following - value[t]
        running = delta + settings.gamma * settings.lam * alive * running
        result[t] = running
    return result


class Ppo:
    """The optimiser and its learning rate.

    There is no left-right mirroring on purpose: a mirror-symmetric network that stands
    symmetrically cannot decide which diagonal to lift first, and so stood still under a command.
    """

    def __init__(self, net: ActorCritic, settings: Settings) -> None:
        self.net = net
        self.settings = settings
        self.max_std = 1.0
        self.rate = 1e-4
        self.optimizer = torch.optim.Adam(net.parameters(), lr=1e-3)

    def update(self, batch: Batch, critic_only: bool = False) -> dict[str, float]:
        """Improve the network on one rollout; returns mean losses and the learning rate."""
        s, net = self.settings, self.net
        count = len(batch.obs)
        size = count // s.minibatches
        old_std = net.log_std.exp().detach()
        sums = np.zeros(4)
        rate = 1e-3 if critic_only else min(self.rate, s.max_rate)
        for _ in range(s.epochs):
            order = torch.randperm(count)
            for start in range(0, size * s.minibatches, size):
                rows = order[start : start + size]
                old_mean = batch.mean[rows]
                hidden = net.actor[:-1](batch.obs[rows])
                dist = net.around(net.actor[-1](hidden))
                log_prob = dist.log_prob(batch.action[rows]).sum(-1)
                std = net.log_std.exp()
                with torch.no_grad():
                    kl = (
                        torch.log(std / old_std)
                        + (old_std**2 + (old_mean - dist.mean) ** 2) / (2 * std**2)
                        - 0.5
                    )
                    kl_mean = kl.sum(-1).mean().item()
                if critic_only:
                    pass
                elif kl_mean > 2 * s.desired_kl:
                    rate = max(s.min_rate, rate / 1.5)
                elif kl_mean < 0.5 * s.desired_kl:
                    rate = min(s.max_rate, rate * 1.5)
                self.optimizer.param_groups[0]["lr"] = rate
                ratio = torch.exp(log_prob - batch.log_prob[rows])
                advantage = batch.advantage[rows]
                gain = torch.min(
                    ratio * advantage, ratio.clamp(1 - s.clip, 1 + s.clip) * advantage
                ).mean()
                value = net.critic(batch.critic[rows]).squeeze(-1)
                value_loss = (value - batch.target[rows]).square().mean()
                speed = net.speed(hidden.detach() if critic_only else hidden)
                speed_loss = (speed - batch.critic[rows, SPEED]).square().mean()
                loss = value_loss + speed_loss
                if not critic_only:
                    loss = loss - gain - s.entropy * dist.entropy().sum(-1).mean()
                self.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(net.parameters(), s.max_grad)
                self.optimizer.step()
                with torch.no_grad():
                    net.log_std.clamp_(max=float(np.log(self.max_std)))
                sums += (-gain.item(), value_loss.item(), speed_loss.item(), kl_mean)
        if not critic_only:
            self.rate = rate
        sums /= s.epochs * s.minibatches
        names = ("policy_loss", "value_loss", "speed_loss", "kl")
        return {**dict(zip(names, sums)), "rate": rate}
