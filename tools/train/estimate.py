"""Fit the velocity estimate that `integral.py` reads: `python estimate.py checkpoint.pt`.

The actor walks over random floors under random commands; the estimate learns its base velocity
from what the robot can measure. A second round walks with the integral of the first, so that the
estimate knows what it brings about. It is added to the checkpoint, which export.py reads.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import contract
import numpy as np
import torch
from env import NUM_CRITIC, Go2Env
from export import weights
from integral import FRAMES, NUM_MEMORY, SEEN, WIDTHS, Integral, Tell, Weights, frames, keep_past
from ppo import ActorCritic, mlp

NOISE = 0.05  # of actions: shows what surrounds the gait
# Time step [s], robots, steps of a round: mostly as trained, some as shipped, which cost thrice.
WALKS = ((0.005, 512, 500), (0.002, 256, 400))
BATCH, RATE, EPOCHS = 2048, 2e-3, 20


@torch.no_grad()
def walk(env: Go2Env, net: ActorCritic, tell: Tell, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """What the estimate may see (n, 126), and the velocity vx, vy [m/s] at that moment (n, 2)."""
    env.push_speed, env.command_period, env.still_share = 0.5, 4.0, 0.05
    env.idle_steps = 2000
    memory = np.zeros((env.num_envs, NUM_MEMORY), np.float32)
    seen, velocity = [], []
    observation, _ = env.observe()
    for _ in range(steps):
        whole = env.steps >= FRAMES
        seen.append(frames(observation, memory)[whole][:, SEEN])
        velocity.append(env.lin_vel[whole, :2].astype(np.float32))
        told, memory = tell(observation, memory)
        action = net.actor(torch.from_numpy(told)).numpy()
        noise = NOISE * env.rng.standard_normal(action.shape).astype(np.float32)
        observation, _, _, done, _ = env.step(action + noise)
        memory[done] = 0.0
        env.physics.refresh(env.rng, 1)
    return np.concatenate(seen), np.concatenate(velocity)


def fit(seen: np.ndarray, velocity: np.ndarray) -> torch.nn.Sequential:
    """Regress the velocity on what is seen, the rate falling."""
    x, y = torch.from_numpy(seen), torch.from_numpy(velocity)
    net = mlp([len(SEEN), *WIDTHS, 2], 1.0)
    optimizer = torch.optim.Adam(net.parameters(), RATE)
    for epoch in range(EPOCHS):
        for rows in torch.randperm(len(x)).split(BATCH):
            loss = torch.nn.functional.mse_loss(net(x[rows]), y[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        optimizer.param_groups[0]["lr"] = RATE * (1.0 - (epoch + 1) / EPOCHS)
    return net


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    saved = torch.load(args.checkpoint)
    values = {k: v for k, v in saved["net"].items() if not k.startswith("estimate.")}
    net = ActorCritic(contract.NUM_OBS, NUM_CRITIC, len(contract.JOINTS))
    net.load_state_dict(values)
    tell: Tell = keep_past
    seen, velocity = [], []
    for round_ in range(2):
        for i, (timestep, robots, steps) in enumerate(WALKS):
            seed = args.seed + 2 * round_ + i
            env = Go2Env(robots, timestep, seed, args.threads, robots, timestep > 0.002)
            x, y = walk(env, net, tell, steps)
            seen.append(x)
            velocity.append(y)
        fitted = {
            f"estimate.{k}": v.detach()
            for k, v in fit(np.concatenate(seen), np.concatenate(velocity)).state_dict().items()
        }
        found: Weights = weights(fitted, "estimate")
        tell = Integral(found)
    saved["net"] = {**values, **fitted}
    torch.save(saved, args.checkpoint)


if __name__ == "__main__":
    main()
