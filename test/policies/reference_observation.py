"""The observation's slow reference: term by term, frame by frame, as training code writes it."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.policies import PolicyContract


class ConcatenateObservation:
    """The observation of one robot by plain concatenation.

    Args:
        contract: the policy.
        robot_joints: the robot's joint order.
        joint_states: states that are in the robot's order.
    """

    def __init__(
        self,
        contract: PolicyContract,
        robot_joints: Sequence[str],
        joint_states: Sequence[str] = ("joint_pos", "joint_vel"),
    ) -> None:
        self.contract = contract
        self.robot_joints = list(robot_joints)
        self.joint_states = joint_states
        self.frames: list[deque[NDArray[np.float32]]] = []
        self.reset()

    def reset(self) -> None:
        self.frames = [deque(maxlen=term.history) for term in self.contract.terms]

    def value(self, i: int, states: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        term = self.contract.terms[i]
        value = states[term.state].astype(np.float32) if term.value is None else term.value
        default = self.contract.default_joint_pos
        if term.state in self.joint_states:
            value = np.array([value[self.robot_joints.index(j)] for j in self.contract.joints])
        if term.index is not None:
            value, default = (
                value[list(term.index)],
                default[list(term.index)] if isinstance(term.subtract, str) else default,
            )
        if isinstance(term.subtract, str):
            value = value - default
        elif term.subtract is not None:
            value = value - term.subtract
        if term.clip is not None:
            value = np.minimum(np.maximum(value, term.clip[0]), term.clip[1])
        return np.asarray(value * term.scale, dtype=np.float32)

    def __call__(self, states: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        spec = self.contract.observation
        for i, frames in enumerate(self.frames):
            value = self.value(i, states)
            while len(frames) < frames.maxlen:  # type: ignore[operator]
                frames.append(value if spec.start == "first" else np.zeros_like(value))
            frames.append(value)
        order = 1 if spec.newest == "last" else -1
        histories = [list(frames)[::order] for frames in self.frames]
        if spec.layout == "term_major":
            parts = [frame for history in histories for frame in history]
        else:
            parts = []
            for count, group in itertools.groupby(histories, len):
                block = list(group)
                parts += [history[k] for k in range(count) for history in block]
        return np.concatenate(parts)
