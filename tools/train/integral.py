"""What the shipped Go2 network does before its actor: it integrates its own speed error.

Told -0.4 m/s, an actor without memory may go back at -0.25, and how far it is off depends on the
robot and the floor. So the actor is told the command plus the integral of the error against an
estimate of the base velocity: the gyro for the turn, a small network that sees what stance legs do
for the rest. `Integral` is the slow reference of the nodes that export.py writes.
"""

from __future__ import annotations

from collections.abc import Callable

import contract
import numpy as np
from env import COMMAND_HIGH, COMMAND_LOW

# Frames that the estimate sees: over 1 s it is off by 0.073 m/s with one, 0.044 with 3,
# 0.039 with 6.
FRAMES = 3
WIDTHS = (64, 32)  # of its hidden layers; (128, 64) bring 0.042 in place of 0.044 m/s
# Of each frame: not the command, or the estimate would believe what was told.
SEEN = np.delete(np.arange(FRAMES * contract.NUM_OBS).reshape(FRAMES, -1), np.s_[6:9], 1).ravel()
COMMAND = slice(6, 9)  # of the observation
# An axis counts in units of 1 m/s, 1 m/s and 2 rad/s, so that one bound serves all three.
UNIT = np.array([1.0, 1.0, 2.0], np.float32)
GAIN = 1.2  # in [1/s]: it settles within two seconds, a stride takes half of one
LARGEST = 0.4  # integral, in units
NOTICED = 0.3  # of the error, in units: a push is not slowness
LAG = 0.3  # of a robot behind its command in [s]: the error is that to a command delayed so
# Share that is forgotten a second for each unit by which the command is ahead of that.
FORGET = 6.0
STILL = 0.025  # units: a command that is all smaller asks to stand
REFERENCE, HELD = slice(0, 3), slice(3, 6)  # of the memory
PAST = slice(6, 6 + (FRAMES - 1) * contract.NUM_OBS)  # frames, the newest first
NUM_MEMORY = PAST.stop
Weights = list[tuple[np.ndarray, np.ndarray]]
Tell = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def frames(observation: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """This observation, the last and the one before, shape (n, 135)."""
    return np.concatenate([observation, memory[:, PAST]], axis=1)


def keep_past(observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An integral that never tells more than was asked for."""
    following = memory.copy()
    following[:, PAST] = frames(observation, memory)[:, : PAST.stop - PAST.start]
    return observation, following


def mlp(value: np.ndarray, weights: Weights) -> np.ndarray:
    """What layers with ELU between them give, shape (n, outputs)."""
    for i, (weight, bias) in enumerate(weights):
        if i:
            value = np.where(value > 0, value, np.expm1(np.minimum(value, 0)))
        value = value @ weight.T + bias
    return value


class Integral:
    """Tells the actor more than was asked for, until its speed is right.

    Attributes:
        weights: (weight, bias) of the estimate's layers; it takes the elements `SEEN` of `frames`
            and gives vx, vy in [m/s].
    """

    def __init__(self, weights: Weights) -> None:
        self.weights = weights

    def velocity(self, observation: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Estimated vx, vy and measured wz in units, shape (n, 3)."""
        planar = mlp(frames(observation, memory)[:, SEEN], self.weights)
        turn = observation[:, 2:3] / contract.OBS_SCALE[2] / UNIT[2]
        return np.concatenate([planar, turn], axis=1)

    def __call__(
        self, observation: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Observations (n, 45) as the actor is to see them, and the next memory (n, 96)."""
        scale = contract.OBS_SCALE[COMMAND] * UNIT
        command = observation[:, COMMAND] / scale
        ahead = command - memory[:, REFERENCE]
        reference = memory[:, REFERENCE] + contract.PERIOD / LAG * ahead
        error = np.clip(reference - self.velocity(observation, memory), -NOTICED, NOTICED)
        kept = 1.0 - contract.PERIOD * FORGET * np.abs(ahead)
        held = kept * memory[:, HELD] + contract.PERIOD * GAIN * error
        moving = np.abs(command).max(axis=1, keepdims=True) > STILL
        held = np.clip(held, -LARGEST, LARGEST) * moving
        told = observation.copy()
        told[:, COMMAND] = scale * np.clip(command + held, COMMAND_LOW / UNIT, COMMAND_HIGH / UNIT)
        past = frames(observation, memory)[:, : PAST.stop - PAST.start]
        following = np.concatenate([reference, held, past], axis=1)
        # What is not a number would stay for ever.
        following = np.where(np.isnan(following), 0.0, following)
        return told.astype(np.float32), following.astype(np.float32)
