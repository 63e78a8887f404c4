"""The exam of the Go2 policy by direction, for `evaluate.py`: many random robots, pushed, delayed.

Every robot has its own floor, mass, strength, gains, target delay and sensor noise, drawn from the
ranges of training (README.md), and obeys one command for 20 s. Physics as shipped: 2 ms, all
contacts. Needs only numpy, mujoco and onnxruntime.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import contract
import numpy as np
import onnxruntime
from env import EPISODE_STEPS, Go2Env

COMMANDS = {  # vx, vy [m/s], wz [rad/s]
    "forward": (0.5, 0.0, 0.0),
    "forward, left": (0.3, 0.3, 0.0),
    "left": (0.0, 0.4, 0.0),
    "backward, left": (-0.3, 0.3, 0.0),
    "backward": (-0.4, 0.0, 0.0),
    "backward, right": (-0.3, -0.3, 0.0),
    "right": (0.0, -0.4, 0.0),
    "forward, right": (0.3, -0.3, 0.0),
    "turn left": (0.0, 0.0, 1.0),
    "turn right": (0.0, 0.0, -1.0),
    "stand": (0.0, 0.0, 0.0),
}
PUSH = 0.5  # [m/s], every `PUSH_STEPS`, in a random direction
PUSH_STEPS = 250
SETTLE_STEPS = 100  # left out of the means: the start
# Observations (n, 45), and which robots start anew (n,), to actions (n, 12).
Policy = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass
class Marks:
    """What one command came to, over its robots.

    Attributes:
        mean: velocity vx, vy [m/s], wz [rad/s] over all robots, shape (3,).
        lin, ang: mean over the robots of how far the mean velocity of each is off, [m/s], [rad/s].
        falls: robots with a base under 0.17 m or tilted beyond 53 degrees.
        impact: mean over touchdowns of the largest normal force of that tick in [N].
    """

    name: str
    command: tuple[float, float, float]
    mean: np.ndarray
    lin: float
    ang: float
    falls: int
    impact: float


def examine(
    policy: Policy, robots: int, seed: int = 5000, threads: int = 1, seconds: float = 20.0
) -> list[Marks]:
    """Let `robots` robots obey each command."""
    names = list(COMMANDS)
    env = Go2Env(len(names) * robots, 0.002, seed, threads, len(names) * robots, feet_only=False)
    env.push_speed = 0.0
    env.command_period = np.inf
    env.idle_steps = EPISODE_STEPS + 1  # a robot that stands has the speed error of standing
    env.steps[:] = 0
    env.command[:] = np.repeat([COMMANDS[name] for name in names], robots, axis=0)
    told = env.command.copy()
    rng = np.random.default_rng(seed)
    alive = np.ones(env.num_envs, bool)
    velocity, ticks = np.zeros((env.num_envs, 3)), np.zeros(env.num_envs)
    force, touchdowns = np.zeros(env.num_envs), np.zeros(env.num_envs)
    observation, _ = env.observe()
    done = np.ones(env.num_envs, bool)
    for step in range(round(seconds / contract.PERIOD)):
        contact = env.contact
        observation, _, _, done, timeout = env.step(policy(observation, done))
        alive &= ~(done & ~timeout)
        env.command[:] = told  # a robot that fell starts anew, and is not looked at again
        if step >= SETTLE_STEPS and not timeout.any():  # a time-out begins a new episode
            velocity[alive, :2] += env.lin_vel[alive, :2]
            velocity[alive, 2] += env.ang_vel[alive, 2]
            ticks[alive] += 1
            down = env.contact & ~contact & alive[:, None]
            force += (env.force * down).sum(axis=1)
            touchdowns += down.sum(axis=1)
        if step % PUSH_STEPS == PUSH_STEPS - 1:
            angle = rng.uniform(-np.pi, np.pi, env.num_envs)
            env.physics.state[:, 20] += PUSH * np.cos(angle)
            env.physics.state[:, 21] += PUSH * np.sin(angle)
    velocity /= np.maximum(ticks, 1)[:, None]
    error = told - velocity
    marks = []
    for i, name in enumerate(names):
        rows = slice(i * robots, (i + 1) * robots)
        marks.append(
            Marks(
                name,
                COMMANDS[name],
                velocity[rows].mean(axis=0),
                float(np.linalg.norm(error[rows, :2], axis=1).mean()),
                float(np.abs(error[rows, 2]).mean()),
                int((~alive[rows]).sum()),
                float(force[rows].sum() / max(touchdowns[rows].sum(), 1)),
            )
        )
    return marks


def load_policy(folder: Path) -> Policy:
    """The network of a policy folder, with a memory for each robot."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        str(folder / "policy.onnx"), options, providers=["CPUExecutionProvider"]
    )
    recurrent = [(given.name, given.shape[1]) for given in session.get_inputs()[1:]]
    memory: dict[str, np.ndarray] = {}

    def act(observation: np.ndarray, fresh: np.ndarray) -> np.ndarray:
        for name, size in recurrent:
            kept = memory.setdefault(name, np.zeros((len(observation), size), np.float32))
            kept[fresh] = 0.0
        action, *following = session.run(None, {"obs": observation, **memory})
        memory.update(zip(memory, following))
        return np.asarray(action)

    return act


def table(marks: list[Marks], robots: int) -> str:
    """The exam's section of EVALUATION.md."""
    head = f"""
## Exam by direction

{robots} robots for each command, 20 s each: {len(marks) * robots} episodes. A robot has its own
floor, mass, strength, gains, target delay (0-20 ms) and sensor noise, drawn from the ranges of
training (`tools/train/README.md`), and is pushed by {PUSH} m/s every 5 s. An error is how far the
mean velocity of one robot is from the command, averaged over the robots, without the first 2 s.
A fall ends an episode. A touchdown is the largest force of a foot in the tick of its landing.

| command | vx, vy [m/s], wz [rad/s] | mean | speed error | yaw rate error | falls | touchdown |
|---|---|---|---|---|---|---|
"""
    rows = []
    for x in marks:
        told = ", ".join(f"{v:g}" for v in x.command)
        got = ", ".join(f"{v:+.2f}" for v in x.mean)
        errors = f"{x.lin:.3f} m/s | {x.ang:.3f} rad/s"
        rows.append(f"| {x.name} | {told} | {got} | {errors} | {x.falls} | {x.impact:.0f} N |\n")
    return head + "".join(rows)
