"""Frames of AzureLoong's joint interface, packed and little endian; for its wire and its face.

With 31 joints and 6 + 6 fingers a command has 684 bytes and a state 1,114. Layouts:
loongOpen's loong_sim_sdk_release, sdk/loong_jnt_sdk/loong_jnt_sdk_datas.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_core.states.standard import COMMAND_STATES
from unicon_ros.hardware.facts import TransportFacts

KEYS = ("enable", "reset", "idle", "walk", "damp", "disable", "commands")
"""Of `transport.keys`: what the remote is told, and what the robot then does."""

_HEAD = ("checker", "<i2"), ("size", "<i2"), ("state", "<i4")


def command_type(joints: int, left: int, right: int) -> np.dtype[Any]:
    """Return the layout of a command: targets [rad], [rad/s], [N·m], gains, fingers.

    Args:
        joints: of the body.
        left: fingers of the left hand.
        right: fingers of the right hand.
    """
    rows = [(name, "<f4", (joints,)) for name in COMMAND_STATES]
    fingers = [("finger_left", "<f4", (left,)), ("finger_right", "<f4", (right,))]
    rates = [("torque_limit_rate", "<f4"), ("filter_rate", "<f4")]
    return np.dtype([*_HEAD, *rates, *rows, *fingers])


def state_type(joints: int, left: int, right: int) -> np.dtype[Any]:
    """Return the layout of a state; see `command_type`.

    `key` is the remote's key and that of the plan that runs, `state` that of the run and the task.
    """
    return np.dtype(
        [
            ("size", "<i4"),
            ("timestamp", "<f8"),
            ("key", "<i2", (2,)),
            ("plan", "S16"),
            ("state", "<i2", (2,)),
            ("joy", "<f4", (4,)),
            *((name, "<f4", (3,)) for name in ("rpy", "gyro", "acc")),
            *((name, "<f4", (joints,)) for name in ("pos", "vel", "effort")),
            *((name, "<i2", (joints,)) for name in ("temperature", "status", "error")),
            *((name, "<f4", (joints,)) for name in ("pos_target", "vel_target", "effort_target")),
            *(
                (f"{which}_{side}", "<f4", (fingers,))
                for which in ("finger", "finger_target")
                for side, fingers in (("left", left), ("right", right))
            ),
        ]
    )


def part(kind: np.dtype[Any], first: str, behind: str) -> slice:
    """Return where the bytes of a frame are from one field up to another, that one left out."""
    fields: Any = kind.fields
    return slice(fields[first][1], fields[behind][1])


@dataclass(frozen=True)
class Link:
    """What both ends of the protocol know of it, from the robot file.

    Attributes:
        port: where the robot takes commands, UDP.
        rate: of frames at most, [Hz].
        checker: in front of each command.
        commanding: `state` of a command that is to be carried out; 0 asks for states alone.
        lost: without a command for so long the robot takes the client for lost, [s].
        keys: of the remote, by the names of `KEYS`.
        command: layout of a command.
        state: layout of a state.
    """

    port: int
    rate: float
    checker: int
    commanding: int
    lost: float
    keys: dict[str, int]
    command: np.dtype[Any]
    state: np.dtype[Any]

    @classmethod
    def of(cls, robot: Robot) -> Link:
        """Return that of a robot file.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        facts, joints = TransportFacts(robot), robot.num_joints
        fingers = facts.integer("fingers_left", 0, 32), facts.integer("fingers_right", 0, 32)
        return cls(
            facts.integer("port", 1, 65535),
            facts.number("rate_hz", 1.0, 1000.0),
            facts.integer("checker", -32768, 32767),
            facts.integer("state", 1, 127),
            1e-3 * facts.integer("lost_ms", 1, 10_000),
            facts.mapping("keys", KEYS, 1, 255),
            command_type(joints, *fingers),
            state_type(joints, *fingers),
        )


@dataclass(frozen=True)
class Limits:
    """What the robot's driver clamps commands to, rows as of `COMMAND_STATES`, shape (5, n).

    Attributes:
        lower: smallest.
        upper: largest.
    """

    lower: NDArray[np.float32]
    upper: NDArray[np.float32]

    @classmethod
    def of(cls, robot: Robot) -> Limits:
        """Return those of a robot file.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        facts = TransportFacts(robot)
        free = np.full(robot.num_joints, np.inf)
        torque = facts.numbers("torque_limit", 0.0, 1000.0)
        gains = [facts.numbers(k, 0.0, 2000.0) for k in ("stiffness_limit", "damping_limit")]
        none = np.zeros_like(free)
        return cls(
            np.array((-free, -free, -torque, none, none), np.float32),
            np.array((free, free, torque, *gains), np.float32),
        )
