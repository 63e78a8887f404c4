"""Block `frames`: where hands and other bodies are, by forward kinematics of the joints.

estimate: [{frames: {of: [left_hand, right_hand]}}]     # left_hand_pose, right_hand_pose
estimate: [{frames: {of: {palm: left_wrist_yaw_link}, frame: world}}]       # palm_pose
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from unicon_base.errors import WorkflowError, alternatives
from unicon_core.blocks.joint_command import single
from unicon_core.flow.block import Reads
from unicon_core.models.frames import Frames as BodyFrames
from unicon_core.robots import Robot
from unicon_core.robots.robot import Place
from unicon_core.states import StateSpec
from unicon_core.states.layout import check_name
from unicon_core.states.standard import pose_of, pose_states
from unicon_core.workflow.autowire import BuildContext

Of = Sequence[str] | Mapping[str, str]


class Frames:
    """Tell the poses of end effectors, or of bodies, as states `NAME_pose`.

    Each is position in [m] and quaternion wxyz, shape (7,). Two neighbouring ticks have the
    quaternion of the same sign.

    Args:
        joint_pos: in [rad] or [m], shape (n,).
        of: end effectors of the robot file, all unless told; or names to bodies of the model.
        frame: `base`, or `world`, which takes `base_pos_w` and `base_quat`.

    Raises:
        WorkflowError: no such end effector, or the states are of a batch.
        ModelError: there is no model, or it lacks a body.
    """

    memory = ()

    def __init__(
        self,
        joint_pos: Reads,
        *,
        context: BuildContext,
        of: Of = (),
        frame: Literal["base", "world"] = "base",
    ) -> None:
        single(joint_pos)
        loaded, states, robot = context.model("frames"), context.states, context.robot
        places = _places(of, robot)
        self.reads: tuple[str, ...] = ()
        if frame == "world" and loaded.base is not None:
            self.reads = ("base_pos_w", "base_quat")
            if context.carried:
                raise WorkflowError(
                    "frame is 'world', and what carries this member is not known here; leave of: "
                    "out beside it, and name bodies of the whole"
                )
        self.writes = tuple(map(pose_of, places))
        self._frames, self._joint_pos = BodyFrames(loaded, robot, places), joint_pos
        self._outs = [states[name] for name in self.writes]
        self._base = [states[name] for name in self.reads]
        self._world = np.array((0, 0, 0, 1.0, 0, 0, 0)) if frame == "world" else None

    @staticmethod
    def declares(
        *, robot: Robot, of: Of = (), frame: str = "base", **_: Any
    ) -> dict[str, StateSpec]:
        """Return the states of the poses."""
        found: dict[str, StateSpec] = {}
        for name in _places(of, robot):
            found |= pose_states(name, frame)
        return found

    def __call__(self) -> None:
        if self._base and self._world is not None:
            self._world[:3], self._world[3:] = self._base
        self._frames(self._joint_pos, self._outs, self._world)


def effector_of(name: str, robot: Robot, block: str) -> Place:
    """Return an end effector of a robot file.

    Args:
        name: of the end effector.
        robot: whose it is.
        block: that asks, for the message.

    Raises:
        WorkflowError: it has none of that name.
    """
    known = robot.end_effectors
    if name in known:
        return known[name]
    remedy = alternatives(name, known) if known else "it names none"
    raise WorkflowError(
        f"block {block!r}: robot {robot.name} has no end effector {name!r}; {remedy}; name one "
        f"under end_effectors in {robot.path}"
    )


def _places(of: Of, robot: Robot) -> dict[str, Place]:
    if isinstance(of, Mapping):
        return {check_name(name): Place(body) for name, body in of.items()}
    words = tuple(of) or tuple(robot.end_effectors)
    if not words:
        raise WorkflowError(
            f"block 'frames': robot {robot.name} names no end effectors; give of: {{NAME: BODY}}, "
            f"or name them under end_effectors in {robot.path}"
        )
    return {word: effector_of(word, robot, "frames") for word in words}
