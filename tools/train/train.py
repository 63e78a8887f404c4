"""Train the Go2 velocity policy: `python train.py`, on two CPU cores, no GPU. See README.md."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # torch's idle threads must not spin

import argparse
import json
import time
from pathlib import Path

import contract
import numpy as np
import onnx
import torch
from correct import correct
from env import Go2Env
from integral import Integral
from network import weights_of
from ppo import ActorCritic, Batch, Ppo, Settings, advantages
from stairs_env import StairsEnv
from warmstart import teach

CRITIC_FIRST = 12  # iterations in which only the critic learns, so that it does not undo the start
# Iterations, and the ceiling of the exploration noise while refining.
REFINE_NOISE = ([0, 50, 1500], [0.12, 0.11, 0.06])
STAIRS_NOISE = ([0, 100, 400, 900], [0.2, 0.2, 0.14, 0.1])


def schedule(env: Go2Env, ppo: Ppo, iteration: int, refine: bool) -> None:
    """Curriculum: first learn to move, then to move well, then to take pushes.

    Refining a network that walks has all costs and pushes at once, and ever less noise.
    """
    if refine:
        env.cost_scale, env.push_speed = 1.0, 0.7
        env.command_period = 4.0
        noise = REFINE_NOISE
        if isinstance(env, StairsEnv):
            env.push_speed, noise = 0.4, STAIRS_NOISE
        ppo.max_std = float(np.interp(iteration, *noise))
        return
    env.cost_scale = float(np.interp(iteration, [0, 300], [0.3, 1.0]))
    env.push_speed = float(np.interp(iteration, [150, 400], [0.2, 0.7]))
    # Exploration noise slows the gait; a policy trained with much of it overshoots without (30 %).
    ppo.max_std = float(np.interp(iteration, [12, 200, 500, 900], [0.25, 0.18, 0.12, 0.08]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/go2_velocity"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--envs", type=int, default=512)
    parser.add_argument("--steps", type=int, default=24)
    parser.add_argument("--iterations", type=int, default=600)
    parser.add_argument("--timestep", type=float, default=0.005)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--resume", type=Path, help="checkpoint of this run")
    parser.add_argument("--refine", type=Path, help="network (.onnx) to go on from")
    parser.add_argument("--stairs", action="store_true", help="steps and a scan: go2_stairs")
    args = parser.parse_args()
    if args.stairs and not args.refine and not args.resume:
        parser.error("--stairs goes on from a network that walks: give --refine policy.onnx")

    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    args.out.mkdir(parents=True, exist_ok=True)
    task = StairsEnv if args.stairs else Go2Env
    env = task(args.envs, args.timestep, args.seed, args.threads)
    if args.stairs:
        env.tell = Integral(weights_of(onnx.load(contract.POLICY_DIR / "policy.onnx"))[1])
    net = ActorCritic(env.num_obs, env.num_critic, len(contract.JOINTS))
    ppo = Ppo(net, Settings(desired_kl=0.025) if args.stairs else Settings())
    first = 0
    if args.resume:
        saved = torch.load(args.resume)
        net.load_state_dict(saved["net"])
        ppo.optimizer.load_state_dict(saved["optimizer"])
        ppo.rate, first = saved["rate"], saved["iteration"] + 1
    elif args.refine:
        copy_actor(args.refine, net)
        if not args.stairs:
            print(f"corrected its speed, mean squared error {correct(env, net):.4f}", flush=True)
            env.pop_stats()
        save(args.out, net, ppo, -1)
    else:
        schedule(env, ppo, 0, False)
        print(f"copied the scripted trot, mean squared error {teach(env, net):.4f}", flush=True)
        env.pop_stats()
        save(args.out, net, ppo, -1)

    log = (args.out / "log.jsonl").open("a", buffering=1)
    start = time.monotonic()
    obs, critic = env.observe()
    for iteration in range(first, args.iterations):
        schedule(env, ppo, iteration, bool(args.refine or args.stairs))
        began = time.monotonic()
        batch, obs, critic, reward = collect(env, net, ppo.settings, args.steps, obs, critic)
        collected = time.monotonic()
        result = ppo.update(batch, critic_only=iteration < CRITIC_FIRST)
        env.physics.refresh(env.rng)
        now = time.monotonic()
        row = {
            "iteration": iteration,
            "wall_s": round(now - start, 1),
            "steps_per_s": round(args.envs * args.steps / (now - began)),
            "collect_s": round(collected - began, 2),
            "reward": reward,
            "std": net.log_std.exp().mean().item(),
            **result,
            **env.pop_stats(),
        }
        log.write(json.dumps({k: float(f"{v:.5g}") for k, v in row.items()}) + "\n")
        if iteration % 50 == 49 or iteration == args.iterations - 1:
            save(args.out, net, ppo, iteration)


def copy_actor(path: Path, net: ActorCritic) -> None:
    """Put the weights of a network that export.py wrote into the actor; a scan counts for 0."""
    layers, _ = weights_of(onnx.load(path))
    parameters = net.actor.parameters()
    with torch.no_grad():
        for layer in layers:
            for array in layer:
                parameter = next(parameters)
                parameter.zero_()
                parameter[..., : array.shape[-1]] = torch.from_numpy(array.copy())


def save(folder: Path, net: ActorCritic, ppo: Ppo, iteration: int) -> None:
    """Write a checkpoint that `--resume` and export.py read."""
    saved = {
        "net": net.state_dict(),
        "optimizer": ppo.optimizer.state_dict(),
        "rate": ppo.rate,
        "iteration": iteration,
    }
    torch.save(saved, folder / f"checkpoint_{iteration + 1}.pt")


@torch.no_grad()
def collect(
    env: Go2Env,
    net: ActorCritic,
    settings: Settings,
    steps: int,
    obs: np.ndarray,
    critic: np.ndarray,
) -> tuple[Batch, np.ndarray, np.ndarray, float]:
    """Roll the policy out; a time-out is not a failure, so its lost future is added as value."""
    rows: dict[str, list[torch.Tensor]] = {k: [] for k in Batch.__annotations__}
    rewards, dones = [], []
    for _ in range(steps):
        obs_t, critic_t = torch.from_numpy(obs), torch.from_numpy(critic)
        dist = net.distribution(obs_t)
        action = dist.sample()
        value = net.critic(critic_t).squeeze(-1)
        obs, critic, reward, done, timeout = env.step(action.numpy())
        rows["obs"].append(obs_t)
        rows["critic"].append(critic_t)
        rows["action"].append(action)
        rows["log_prob"].append(dist.log_prob(action).sum(-1))
        rows["mean"].append(dist.mean)
        rows["value"].append(value)
        rewards.append(
            torch.from_numpy(reward) + settings.gamma * value * torch.from_numpy(timeout)
        )
        dones.append(torch.from_numpy(done).float())
    last = net.critic(torch.from_numpy(critic)).squeeze(-1)
    reward_t, done_t, value_t = torch.stack(rewards), torch.stack(dones), torch.stack(rows["value"])
    gae = advantages(reward_t, done_t, value_t, last, settings)
    rows["target"] = [gae + value_t]
    rows["advantage"] = [(gae - gae.mean()) / (gae.std() + 1e-8)]
    flat = {
        k: torch.cat(
            [x.reshape(-1, *x.shape[2:]) if k in ("target", "advantage") else x for x in v]
        )
        for k, v in rows.items()
    }
    return Batch(**flat), obs, critic, reward_t.mean().item()


if __name__ == "__main__":
    main()
