"""Runs that are made up: a walk of four legs as an `.npz`, with whatever fault is wanted in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

LEGS = [f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]
CALF = LEGS.index("RL_calf")


def walk(
    seconds: float = 6.0, rate: float = 50.0, begin: float = 0.0, seed: int = 0
) -> dict[str, Any]:
    """Return a walk whose speed changes, so that it never repeats exactly.

    Args:
        seconds: how long.
        rate: in [Hz].
        begin: where in the walk its first sample is, in [s].
        seed: of the noise of its sensors; what moves is always the same.
    """
    own = np.arange(round(seconds * rate)) / rate
    time = own + begin
    phase = 2 * np.pi * (1.5 * time + 0.8 * np.sin(0.5 * time))
    count = len(LEGS)
    legs = np.repeat([0.0, np.pi, 1.2 * np.pi, 0.2 * np.pi], 3)
    size = np.tile([0.05, 0.3, 0.4], 4)
    middle = np.tile([0.1, 0.8, -1.6], 4)
    wave = phase[:, None] + legs + 0.3 * np.arange(count)
    torque = np.tile([2.0, 4.0, 9.0], 4) * (1.0 + 0.5 * np.sin(wave + 1.0))
    target = middle + size * np.sin(wave) + torque / 40.0
    noise = np.random.default_rng(seed).normal(size=(3, len(time), count))
    velocity = np.gradient(size * np.sin(wave), 1.0 / rate, axis=0)
    position = middle + size * np.sin(wave) + 0.003 * noise[0]
    return {
        "joint_names": np.array(LEGS),
        "stamp_ns": np.round(own * 1e9).astype(np.int64) + 1_700_000_000_000_000_000,
        "joint_pos": position,
        "joint_vel": velocity + 0.05 * noise[1],
        "joint_pos_target": target,
        "joint_stiffness": np.full(wave.shape, 40.0),
        "joint_damping": np.zeros(wave.shape),
        "joint_effort": 40.0 * (np.roll(target, 1, axis=0) - position) + 0.05 * noise[2],
        "projected_gravity": np.tile([0.0, 0.0, -1.0], (len(time), 1)),
        "base_ang_vel": 0.1 * np.stack([np.sin(phase)] * 3, axis=1),
    }


def save(path: Path, run: dict[str, Any]) -> Path:
    """Write a run."""
    np.savez(path, **run)
    return path
